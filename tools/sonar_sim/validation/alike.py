"""A recording and its simulation, number by number."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.beamformer import beam_sines
from sonar_sim.validation.recording import Recorded, band_centres_m, noise_level_db, noisy_bands
from sonar_sim.validation.statistics import (
    beam_correlation,
    class_correlation,
    flat_blocks,
    linear_amplitude,
    ping_correlation,
    row_correlation,
    speckle,
)

CLASSES = ((0.0, 12.0), (12.0, 25.0), (25.0, 50.0), (50.0, 100.0), (100.0, 256.0))
"""Of the mean pixel, for the correlation between pings."""
CLASS_REFERENCE = (0.02, 0.3, 0.5, 0.63, 0.97)
CLASS_TOLERANCE = (0.12, 0.15, 0.15, 0.15, 0.03)
"""The faint classes hold some thousand cells of one scene."""
SILENT_ROWS, BRIGHT_ROWS, EVEN_ROWS = slice(22, 168), slice(260, 430), slice(480, 700)
"""Of the public recording: noise alone; far above it; without shapes of the scene's own."""
LINE_BLOCK = 10
"""Side of the blocks of the reference, for the lines' correlation."""
RISE_M = (0.26, 1.9)
TAIL_M = (1.37, 1.62, 2.0)
"""Ranges of the public recording behind its floor: the tail, and what noise nearly covers."""


@dataclass(frozen=True, slots=True)
class RecordingComparison:
    """One number of both.

    Attributes:
        what: the number, with its unit.
        reference: as the project's reference gives it for this recording; None: it does not.
        real: by this program, on the recording.
        simulated: by this program, on the simulation.
        tolerance: largest allowed difference of the two.
    """

    what: str
    reference: float | None
    real: float
    simulated: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether they are near enough; false for NaN."""
        return abs(self.real - self.simulated) <= self.tolerance


def compare(recorded: Recorded, simulated: NDArray[np.uint8]) -> tuple[RecordingComparison, ...]:
    """Work out all numbers on both.

    Args:
        recorded: the recording.
        simulated: pixels (pings, rows, beams) of the same sonar.
    """
    both = (recorded.pixels, simulated)
    return (
        *_speckle(recorded, both),
        *_lines(recorded, both),
        *_pings(recorded, both),
        *_floor(recorded, both),
        *_tail(recorded, both),
        _bearings(recorded),
    )


Both = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def _pair(numbers: Iterable[float]) -> tuple[float, float]:
    real, simulated = numbers
    return real, simulated


def _speckle(recorded: Recorded, both: Both) -> list[RecordingComparison]:
    gamma_byte = recorded.sonar.gamma_byte
    patches = [np.concatenate([flat_blocks(p, gamma_byte) for p in pixels]) for pixels in both]
    real, simulated = (speckle(patch) for patch in patches)
    raised = [patch ** (gamma_byte / 255.0) for patch in patches]
    cvs = _pair(_block_cv(patch) for patch in raised)
    power_cvs = _pair(_block_cv(np.square(patch)) for patch in patches)
    return [
        RecordingComparison("CV of amplitude", 0.519, real.cv, simulated.cv, 0.03),
        RecordingComparison("skewness", 0.679, real.skewness, simulated.skewness, 0.12),
        RecordingComparison("median over mean", 0.942, real.median, simulated.median, 0.012),
        RecordingComparison("P(A > 2 means)", 0.0411, real.above_2, simulated.above_2, 0.006),
        RecordingComparison("CV of power, median block", 0.967, *power_cvs, 0.06),
        RecordingComparison("CV of pixel, median block", 0.279, *cvs, 0.015),
        RecordingComparison(
            "Kolmogorov to Rayleigh",
            0.005,
            real.rayleigh_distance,
            simulated.rayleigh_distance,
            0.01,
        ),
    ]


def _block_cv(patches: NDArray[np.float64]) -> float:
    return float(np.median(patches.std(axis=(1, 2)) / patches.mean(axis=(1, 2))))


def _lines(recorded: Recorded, both: Both) -> list[RecordingComparison]:
    amplitudes = [linear_amplitude(pixels, recorded.sonar.gamma_byte) for pixels in both]

    def beams(lag: int) -> tuple[float, float]:
        return _pair(
            float(np.mean([beam_correlation(a[EVEN_ROWS], lag) for a in pings]))
            for pings in amplitudes
        )

    def rows(lag: int) -> tuple[float, float]:
        return _pair(
            float(np.mean([row_correlation(a, lag, LINE_BLOCK) for a in pings]))
            for pings in amplitudes
        )

    return [
        RecordingComparison("beams at lag 1, even part", 0.63, *beams(1), 0.03),
        RecordingComparison("beams at lag 2, even part", None, *beams(2), 0.05),
        RecordingComparison("rows at lag 1", 0.19, *rows(1), 0.03),
        RecordingComparison("rows at lag 2", 0.04, *rows(2), 0.04),
    ]


def _pings(recorded: Recorded, both: Both) -> list[RecordingComparison]:
    amplitudes = [linear_amplitude(pixels, recorded.sonar.gamma_byte) for pixels in both]

    def of_class(bounds: tuple[float, float]) -> tuple[float, float]:
        return _pair(
            class_correlation(list(a), list(p), *bounds)
            for a, p in zip(amplitudes, both, strict=True)
        )

    def of_rows(rows: slice) -> tuple[float, float]:
        return _pair(ping_correlation([ping[rows] for ping in a]) for a in amplitudes)

    return [
        *(
            RecordingComparison(
                f"pings, pixels {c[0]:g} to {c[1]:g}", reference, *of_class(c), tolerance
            )
            for c, reference, tolerance in zip(
                CLASSES, CLASS_REFERENCE, CLASS_TOLERANCE, strict=True
            )
        ),
        RecordingComparison("pings, noise alone", 0.0, *of_rows(SILENT_ROWS), 0.1),
        RecordingComparison("pings, bright", 0.98, *of_rows(BRIGHT_ROWS), 0.05),
    ]


def _floor(recorded: Recorded, both: Both) -> list[RecordingComparison]:
    sonar = recorded.sonar
    range_m = band_centres_m(sonar)
    levels = [noise_level_db(pixels, sonar.gamma_byte) for pixels in both]
    rises = _pair(float(np.diff(np.interp(RISE_M, range_m, v))[0]) for v in levels)
    gap = (levels[1] - levels[0])[noisy_bands(sonar)]
    return [
        RecordingComparison("noise, rise from 0.26 to 1.9 m, dB", 30.0, *rises, 3.0),
        RecordingComparison(
            "noise, largest difference, dB", None, 0.0, float(np.abs(gap).max()), 3.0
        ),
    ]


def _tail(recorded: Recorded, both: Both) -> list[RecordingComparison]:
    """Behind the floor: level, and what of tail and of dark pixels stays from ping to ping."""
    range_m = recorded.sonar.row_centres_m
    amplitudes = [linear_amplitude(pixels, recorded.sonar.gamma_byte) for pixels in both]
    near, far = ((range_m > low) & (range_m < high) for low, high in itertools.pairwise(TAIL_M))

    def level_db(rows: NDArray[np.bool_]) -> tuple[float, float]:
        return _pair(10.0 * math.log10(np.mean(np.square(a[:, rows]))) for a in amplitudes)

    def stays(rows: NDArray[np.bool_]) -> tuple[float, float]:
        return _pair(ping_correlation([ping[rows] for ping in a]) for a in amplitudes)

    return [
        RecordingComparison("tail, dB of full scale", None, *level_db(near), 1.5),
        RecordingComparison("tail and noise, dB of full scale", None, *level_db(far), 1.5),
        RecordingComparison("pings, tail", None, *stays(near), 0.1),
        RecordingComparison("pings, dark pixels behind the floor", 0.22, *stays(far), 0.06),
    ]


def _bearings(recorded: Recorded) -> RecordingComparison:
    sines = beam_sines(recorded.sonar, Physics(sine_bearings=True))
    gap_deg = np.abs(np.degrees(np.arcsin(sines)) - recorded.bearings_deg).max()
    return RecordingComparison("bearings, largest difference, deg", 0.0, 0.0, float(gap_deg), 0.01)
