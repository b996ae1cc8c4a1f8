"""A coarse picture of a ping: expected power of surfaces and clouds."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.effects.echoes import COLUMNS, CoarseFan, Echoes
from sonar_sim.effects.image_difference import Tolerance, level_change_db
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.beam_pattern import (
    azimuth_amplitude,
    main_lobe_end,
    vertical_two_way_power,
)
from sonar_sim.propagation.clouds import box_crossing
from sonar_sim.propagation.physics import Cloud
from sonar_sim.receiver.gain import MAX_DB
from sonar_sim.scene.sonar import SonarSettings

MAX_ROWS = 128
OFFSETS = 16
"""In a beams' distance, at which a beam's pattern is summed."""
MAX_LOSS_DB = 2000.0
"""Limit of loss: beyond it echoes are inaudible, but the loss can still be removed."""


@dataclass(frozen=True, eq=False)
class CoarseGrid:
    """Rows and columns of the coarse picture, and how echoes fall into it.

    Attributes:
        sonar: whose picture it is.
        max_rows: of the coarse picture.
    """

    sonar: SonarSettings
    max_rows: int = MAX_ROWS

    @property
    def rows(self) -> int:
        """Number of coarse rows."""
        return min(self.max_rows, self.sonar.rows)

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
        leaked = chunked_matmul(main.astype(np.float32), side_lobe_matrix(self.sonar))
        picture: NDArray[np.float64] = main + leaked
        return picture

    def main_lobes(self, echoes: Echoes, power: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same through the main lobes alone.

        A patch spreads evenly over the ranges that it covers, and over the beams of its column;
        a beam hears several columns of the fine grid, more than one by its equivalent width.
        """
        received = power * (
            self.sonar.range_resolution_m
            * equivalent_beams(self.sonar)
            / max(self.column_beams, 1.0)
        )
        return _core.spread_over_rows(
            echoes.column,
            echoes.range_m,
            echoes.extent_m,
            received,
            self.row_m,
            self.rows,
            COLUMNS,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """From power at the receiver to amplitude of full scale.

    Attributes:
        tvg_db: time-varied gain of each coarse row, (rows,).
        operator_db: the operator's gain.
        full_scale_db: level after gains that fills the scale.
    """

    tvg_db: NDArray[np.float64]
    operator_db: float
    full_scale_db: float

    def amplitude(self, power: NDArray[np.float64]) -> NDArray[np.float64]:
        """Amplitude of full scale, not clipped, (rows, COLUMNS)."""
        gain_db = np.minimum(self.tvg_db + self.operator_db - self.full_scale_db, MAX_DB)
        shown: NDArray[np.float64] = np.sqrt(power) * (10.0 ** (gain_db / 20.0))[:, None]
        return shown


def transmitted_power(loss_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a loss leaves of a power, any shape."""
    ratio: NDArray[np.float64] = 10.0 ** (-np.minimum(loss_db, MAX_LOSS_DB) / 10.0)
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
    return level_change_db(
        before,
        after,
        sonar,
        tolerance.share,
        cells if displaced else (0.0, 0.0),
        limit=1.0,
        brighter=10.0 ** (tolerance.brighter_db / 20.0),
    )


@lru_cache(maxsize=32)
def equivalent_beams(sonar: SonarSettings) -> float:
    """Width of a beam in beams: of its pattern's power, over the beams' distance."""
    offset = np.arange(-256.0 * OFFSETS, 256.0 * OFFSETS + 1.0) / OFFSETS
    return float(np.sum(np.square(_pattern(sonar, offset * sonar.sine_pitch)))) / OFFSETS


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


def _pattern(sonar: SonarSettings, sine: NDArray[np.float64]) -> NDArray[np.float64]:
    return azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)(sine)


def cloud_filling(
    cloud: Cloud,
    grid: CoarseGrid,
    fan: CoarseFan,
    map_T_sonar: FramePose,  # noqa: N803 frames in the name
    end_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Fraction of each cell's insonified water that a cloud fills, attenuated, (rows, COLUMNS).

    Each ray fills its cone between entry and exit; the cloud swallows on the way what it does.

    Args:
        cloud: its box and what it does.
        grid: of the picture.
        fan: the coarse rays.
        map_T_sonar: where they start.
        end_m: where each ends, (N,).
    """
    direction = fan.directions @ map_T_sonar.rotation.T
    enter_m, leave_m = box_crossing(
        cloud, map_T_sonar.position_m, direction.astype(np.float32), np.minimum(end_m, 1e6)
    )
    inside = np.flatnonzero(leave_m > enter_m)
    if len(inside) == 0:
        return np.zeros((grid.rows, COLUMNS))
    up, column = fan.directions[inside, 2], fan.column[inside]
    width_rad = grid.sonar.vertical_width_rad
    weight = vertical_two_way_power(up, width_rad) * fan.solid_angle_sr[inside] / fan.sine_step
    filled = _from(enter_m[inside] / grid.row_m, column, weight, grid.rows)
    filled -= _from(leave_m[inside] / grid.row_m, column, weight, grid.rows)
    total = np.maximum(np.bincount(column, weight, COLUMNS), 1e-30)
    mean_enter_m = np.bincount(column, weight * enter_m[inside], COLUMNS) / total
    depth_m = np.maximum(grid.range_m[:, None] - mean_enter_m, 0.0)
    swallowed = 10.0 ** (-0.2 * cloud.attenuation_db_per_m * depth_m)
    w = np.linspace(-1.0, 1.0, 401)
    whole = float(np.trapezoid(vertical_two_way_power(w, width_rad), w))
    part: NDArray[np.float64] = np.maximum(filled, 0.0) * swallowed / whole
    return part


def _from(
    start_row: NDArray[np.float64],
    column: NDArray[np.int64],
    weight: NDArray[np.float64],
    rows: int,
) -> NDArray[np.float64]:
    """Weights of rays summed over all rows from each one's start on, (rows, COLUMNS)."""
    whole = np.minimum(start_row, rows).astype(np.int64)
    part = np.where(whole < rows, start_row - whole, 0.0)
    size = (rows + 2) * COLUMNS
    steps = np.bincount(whole * COLUMNS + column, weight * (1.0 - part), size)
    steps = steps + np.bincount((whole + 1) * COLUMNS + column, weight * part, size)
    summed = np.cumsum(steps.reshape(rows + 2, COLUMNS), axis=0, dtype=np.float64)
    return summed[:rows]
