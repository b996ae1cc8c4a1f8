"""The beamformer: what each beam and row receives of the cells around it."""

import functools
import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, main_lobe_end
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.sonar import SonarSettings

ROW_LEAK = 0.26
"""Field that leaks into the neighbouring row, against a row's own; gives the amplitude correlation
of 0.19 between neighbouring rows that a public recording shows on the whole. (In the recording's
flat patches alone it is less than 0.1: part of the 0.19 is the scene's.)"""

FOCUS_STEP = 1.125
"""Ratio of beam widths between neighbouring bands of rows nearer than the focus."""

Cell = TypeVar("Cell", np.complex64, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class BeamFormer:
    """The receiving array and its matched filter, ready for any number of pings.

    Attributes:
        taps: amplitude weights of the columns about a beam's own, (odd,); or (beams, count) when
            the beams do not follow the columns' pitch.
        firsts: column of the first beam, or (beams,) of each beam's first tap.
        beams: their number.
        range_taps: amplitude weights of the rows about a cell's own, (odd,).
        near: beam formers of the rows nearer than the focus, each with its first and last row;
            what is beyond them is this one's own.
    """

    taps: NDArray[np.float32]
    firsts: int | NDArray[np.int64]
    beams: int
    range_taps: NDArray[np.float32]
    near: tuple[tuple[int, int, "BeamFormer"], ...] = ()

    def form(self, cells: NDArray[Cell], threads: int = 2) -> NDArray[Cell]:
        """Turn cells (rows, columns) into beams (rows, beams): fields coherently, powers summed."""
        beams = self._form_all(cells, threads)
        halo = len(self.range_taps) // 2
        for first, last, former in self.near:
            begin = max(first - halo, 0)
            part = np.ascontiguousarray(cells[begin : last + halo])
            formed = former.form(part, threads)
            beams[first:last] = formed[first - begin : last - begin]
        return beams

    def _form_all(self, cells: NDArray[Cell], threads: int) -> NDArray[Cell]:
        power = not np.iscomplexobj(cells)
        taps = np.square(self.taps) if power else self.taps
        range_taps = np.square(self.range_taps) if power else self.range_taps
        if isinstance(self.firsts, int):
            return _core.form_beams(cells, taps, self.firsts, self.beams, range_taps, threads)
        return _core.form_beams_at(cells, taps, self.firsts, range_taps, threads)

    @property
    def noise_gain(self) -> float:
        """Rms amplitude in the beams of a field of rms 1, independent in every cell."""
        weights = self.taps[self.beams // 2] if self.taps.ndim > 1 else self.taps
        spread = np.sum(np.square(self.range_taps, dtype=np.float64))
        return math.sqrt(float(np.sum(np.square(weights, dtype=np.float64)) * spread))


def beam_former(sonar: SonarSettings, physics: Physics, margin: int) -> BeamFormer:
    """Design the beam former of a sonar under the given physics.

    Args:
        sonar: its beams, their pitch and the shading.
        physics: beam width, side lobes, range spread and bearing table are taken from it.
        margin: columns of the grid before the first beam, at the beams' mean pitch in the sine.
    """
    former = _design(sonar, physics, margin)
    if physics.focus_m is None or physics.beam_width_rad is None:
        return former
    # From the focus inwards, in bands of much the same width.
    near, outer_m = [], physics.focus_m
    while outer_m > sonar.row_centres_m[0]:
        inner_m = outer_m / FOCUS_STEP
        rows = np.flatnonzero((sonar.row_centres_m <= outer_m) & (sonar.row_centres_m > inner_m))
        if len(rows):
            part = math.sqrt(inner_m * outer_m) / physics.focus_m
            wide = _design(sonar, physics, margin, part)
            near.append((int(rows[0]), int(rows[-1]) + 1, wide))
        outer_m = inner_m
    return replace(former, near=tuple(near))


def _design(sonar: SonarSettings, physics: Physics, margin: int, part: float = 1.0) -> BeamFormer:
    """Design a beam former with a pattern 1 / part times as wide and the same noise gain."""
    range_taps = range_response() if physics.range_spread else np.ones(1, dtype=np.float32)
    reach = _reach(sonar, physics, margin)
    if physics.side_lobe_db is None:
        reach = min(math.ceil(reach / part), sonar.beams + margin)
    gain = math.sqrt(part)
    if physics.sine_bearings:
        offsets: NDArray[np.float64] = np.arange(-reach, reach + 1, dtype=np.float64)
        taps = gain * _weights(sonar, physics, part * offsets)
        return BeamFormer(taps, margin, sonar.beams, range_taps)
    place = margin + beam_sines(sonar, physics) / sonar.sine_pitch + (sonar.beams - 1) / 2.0
    firsts = np.floor(place).astype(np.int64) - reach
    offsets = firsts[:, None] + np.arange(2 * reach + 2) - place[:, None]
    taps = gain * _weights(sonar, physics, part * offsets)
    return BeamFormer(taps, firsts, sonar.beams, range_taps)


def beam_sines(sonar: SonarSettings, physics: Physics) -> NDArray[np.float64]:
    """Sine of each beam's bearing, (beams,): a line array's law, or equal angles without it."""
    half = sonar.half_aperture_rad
    if physics.sine_bearings:
        return np.linspace(-math.sin(half), math.sin(half), sonar.beams)
    sines: NDArray[np.float64] = np.sin(np.linspace(-half, half, sonar.beams))
    return sines


def range_response() -> NDArray[np.float32]:
    """Weights of a row and its two neighbours; the power of independent rows is kept."""
    shape = np.array([ROW_LEAK, 1.0, ROW_LEAK])
    weights: NDArray[np.float32] = (shape / np.linalg.norm(shape)).astype(np.float32)
    return weights


def _reach(sonar: SonarSettings, physics: Physics, margin: int) -> int:
    """Columns on each side that a beam hears."""
    if physics.beam_width_rad is None:
        return 0
    if physics.side_lobe_db is None:
        end = main_lobe_end(physics.beam_width_rad, sonar.side_lobe_db)
        return math.ceil(end / sonar.sine_pitch)
    # Half the fan at the least, and as much more as a transform whose length is a power of two
    # gives for nothing.
    least = sonar.beams + margin + sonar.beams // 2
    return int(2 ** math.ceil(math.log2(least))) - sonar.beams - margin


def _weights(
    sonar: SonarSettings, physics: Physics, offsets: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Amplitude by which a beam hears columns at offsets, in pitches."""
    if physics.beam_width_rad is None:
        nearest: NDArray[np.float32] = np.maximum(1.0 - np.abs(offsets), 0.0).astype(np.float32)
        return nearest
    lobes_db = sonar.side_lobe_db if physics.side_lobe_db is None else physics.side_lobe_db
    sines = offsets * sonar.sine_pitch
    amplitude = azimuth_amplitude(physics.beam_width_rad, lobes_db)(sines)
    if physics.side_lobe_db is None:
        amplitude[np.abs(sines) > main_lobe_end(physics.beam_width_rad, lobes_db)] = 0.0
    weights: NDArray[np.float32] = amplitude.astype(np.float32)
    return weights


FRACTIONS = 128
TAPS = 6
FIT_HALF_WIDTH = 24
"""Pitches on each side over which the beams' pattern is matched."""
NEAREST = np.array([[1.0, 0.0], [0.0, 1.0]], dtype=np.float32)


def column_taps(sonar: SonarSettings, physics: Physics) -> NDArray[np.float32]:
    """Weights of whole columns for echoes between two of them, by the fraction, (F, even).

    Column 0 of the weights is the one `count / 2 - 1` before the echo. Without a beam pattern each
    echo falls into the nearest column.
    """
    if physics.beam_width_rad is None:
        return NEAREST
    lobes_db = sonar.side_lobe_db if physics.side_lobe_db is None else physics.side_lobe_db
    return _fitted(
        physics.beam_width_rad,
        lobes_db,
        sonar.sine_pitch,
        power=not physics.speckle,
        main_only=physics.side_lobe_db is None,
    )


def cells_share(sonar: SonarSettings, physics: Physics) -> float:
    """Mean power that an echo leaves in the cells, over what a beam upon it receives.

    Weights of whole columns overlap: in a field their squares add to less than 1.
    """
    taps = column_taps(sonar, physics).astype(np.float64)
    return float(np.mean(np.sum(np.square(taps) if physics.speckle else taps, axis=1)))


@functools.lru_cache(maxsize=16)
def _fitted(
    width_rad: float, side_lobe_db: float, pitch: float, *, power: bool, main_only: bool
) -> NDArray[np.float32]:
    """Least squares: the shifted pattern as a sum of patterns about whole columns."""
    pattern = azimuth_amplitude(width_rad, side_lobe_db)
    null = main_lobe_end(width_rad, side_lobe_db)

    def heard(offset: NDArray[np.float64]) -> NDArray[np.float64]:
        sine = offset * pitch
        amplitude = pattern(sine)
        if main_only:
            amplitude = np.where(np.abs(sine) > null, 0.0, amplitude)
        return np.square(amplitude) if power else amplitude

    place = np.linspace(-FIT_HALF_WIDTH, FIT_HALF_WIDTH, 16 * FIT_HALF_WIDTH + 1)
    whole = np.arange(TAPS) - (TAPS // 2 - 1)
    fraction = (np.arange(FRACTIONS) + 0.5) / FRACTIONS
    basis = heard(place[:, None] - whole)
    wanted = heard(place[:, None] - fraction)
    weights = np.linalg.lstsq(basis, wanted, rcond=1e-6)[0]
    return np.ascontiguousarray(weights.T, dtype=np.float32)
