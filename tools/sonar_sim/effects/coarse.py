"""The coarse picture in which the rules see what an effect does: expected powers, few cells."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.echoes import COLUMNS, Echoes
from sonar_sim.geometry.matmul import product
from sonar_sim.picture_change import level_change_db
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, main_lobe_end
from sonar_sim.receiver.gain import MOST_DB
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.tolerance import Tolerance

MOST_ROWS = 128
MOST_LOSS_DB = 2000.0
"""Beyond it all is silent, but not so that nobody could tell what was there without the loss."""


@dataclass(frozen=True, eq=False)
class CoarseGrid:
    """Rows and columns of the coarse picture, and how echoes fall into it.

    Attributes:
        sonar: whose picture it is.
        most_rows: of the coarse picture.
    """

    sonar: SonarSettings
    most_rows: int = MOST_ROWS

    @property
    def rows(self) -> int:
        """Number of coarse rows."""
        return min(self.most_rows, self.sonar.rows)

    @property
    def row_m(self) -> float:
        """Height of a coarse row."""
        return self.sonar.range_m / self.rows

    @cached_property
    def range_m(self) -> NDArray[np.float64]:
        """Range of each row's middle, (rows,)."""
        centres: NDArray[np.float64] = (np.arange(self.rows, dtype=np.float64) + 0.5) * self.row_m
        return centres

    @cached_property
    def sine(self) -> NDArray[np.float64]:
        """Starboard sine of each column's middle, (COLUMNS,)."""
        edge = math.sin(self.sonar.half_aperture_rad) + self.sonar.sine_pitch / 2.0
        middles: NDArray[np.float64] = ((np.arange(COLUMNS) + 0.5) / COLUMNS * 2.0 - 1.0) * edge
        return middles

    @property
    def column_beams(self) -> float:
        """Beams that a column stands for."""
        return self.sonar.beams / COLUMNS

    def picture(self, echoes: Echoes, power: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected power of a pixel in each coarse cell, side lobes included, (rows, COLUMNS)."""
        main = self.main_lobes(echoes, power)
        leaked = product(main.astype(np.float32), side_lobe_matrix(self.sonar))
        picture: NDArray[np.float64] = main + leaked
        return picture

    def main_lobes(self, echoes: Echoes, power: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same through the main lobes alone.

        A patch spreads evenly over the ranges that it covers, and over the beams of its column;
        a beam hears several columns of the fine grid, more than one by its equivalent width.
        """
        reach = np.maximum(echoes.extent_m, self.row_m)
        density = power * self.sonar.range_resolution_m / reach
        density *= equivalent_beams(self.sonar) / max(self.column_beams, 1.0)
        first = np.floor((echoes.range_m - reach / 2.0) / self.row_m + 0.5).astype(np.int64)
        count = np.maximum(np.rint(reach / self.row_m).astype(np.int64), 1)
        first, last = np.clip(first, 0, self.rows), np.clip(first + count, 0, self.rows)
        size = (self.rows + 1) * COLUMNS
        begun = np.bincount(first * COLUMNS + echoes.column, density, size)
        ended = np.bincount(last * COLUMNS + echoes.column, density, size)
        filled = np.cumsum((begun - ended).reshape(self.rows + 1, COLUMNS), axis=0)
        picture: NDArray[np.float64] = np.maximum(filled[:-1], 0.0)
        return picture


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """From power at the receiver to amplitude of full scale.

    Attributes:
        varied_db: time-varied gain of each coarse row, (rows,).
        operator_db: the operator's gain.
        full_scale_db: level after gains that fills the scale.
    """

    varied_db: NDArray[np.float64]
    operator_db: float
    full_scale_db: float

    def amplitude(self, power: NDArray[np.float64]) -> NDArray[np.float64]:
        """Amplitude of full scale, not clipped, (rows, COLUMNS)."""
        gain_db = np.minimum(self.varied_db + self.operator_db - self.full_scale_db, MOST_DB)
        shown: NDArray[np.float64] = np.sqrt(power) * (10.0 ** (gain_db / 20.0))[:, None]
        return shown


def left_by(loss_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a loss leaves of a power, any shape."""
    ratio: NDArray[np.float64] = 10.0 ** (-np.minimum(loss_db, MOST_LOSS_DB) / 10.0)
    return ratio


def change_db(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    sonar: SonarSettings,
    tolerance: Tolerance,
    *,
    displaced: bool = True,
) -> float:
    """How much two coarse pictures of amplitude differ; clipped as the receiver would.

    What a displacement by the tolerated part of the sonar's own cells explains does not count,
    unless `displaced` is off.
    """
    rows, columns = before.shape
    cells = tolerance.cells * rows / sonar.rows, tolerance.cells * columns / sonar.beams
    brighter = 10.0 ** (tolerance.brighter_db / 20.0)
    return level_change_db(
        np.minimum(before, 1.0) * brighter,
        np.minimum(after, 1.0) * brighter,
        sonar,
        tolerance.share,
        cells if displaced else (0.0, 0.0),
    )


@lru_cache(maxsize=32)
def equivalent_beams(sonar: SonarSettings) -> float:
    """Sum of the squared weights by which a beam hears the columns: its width in beams."""
    return float(np.sum(np.square(_pattern(sonar, _offsets(sonar)))))


@lru_cache(maxsize=32)
def side_lobe_matrix(sonar: SonarSettings) -> NDArray[np.float32]:
    """Power that a column of the coarse picture leaks into the others, (COLUMNS, COLUMNS).

    The picture's powers include the main lobe's equivalent width: divided out here.
    """
    steps = np.arange(-COLUMNS + 1, COLUMNS) * sonar.beams / COLUMNS
    fine = np.arange(0, max(round(sonar.beams / COLUMNS), 1)) - (sonar.beams / COLUMNS - 1.0) / 2.0
    sine = (steps[:, None] + fine) * sonar.sine_pitch
    squared = np.square(_pattern(sonar, sine))
    squared[np.abs(sine) < main_lobe_end(sonar.beam_width_rad, sonar.side_lobe_db)] = 0.0
    leak = squared.mean(axis=1) * sonar.beams / COLUMNS / equivalent_beams(sonar)
    index = np.arange(COLUMNS)
    # Sums of powers lose nothing in single precision.
    matrix: NDArray[np.float32] = leak[index[:, None] - index + COLUMNS - 1].astype(np.float32)
    matrix.setflags(write=False)
    return matrix


def _offsets(sonar: SonarSettings) -> NDArray[np.float64]:
    offsets: NDArray[np.float64] = np.arange(-256.0, 257.0) * sonar.sine_pitch
    return offsets


def _pattern(sonar: SonarSettings, sine: NDArray[np.float64]) -> NDArray[np.float64]:
    return azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)(sine)
