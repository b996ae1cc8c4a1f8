"""Detects the first return of each beam in levels in decibels above the noise.

A sample belongs to a return if it exceeds the mean level of the water before it, exceeds the noise,
and is not so far below the strongest echo at its range that it may be its side lobe. The mean is in
decibels, so that one bright sample does not hide the next. Only samples nearer to the sonar are
compared: beyond the first surface lie its shadow or other surfaces. A return begins with the first
run of such samples.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import ScanExtractionConfig
from mapperd.imaging.ping_image import PingImage

__all__ = ["FirstReturns", "RangeLimits", "equalised", "first_returns", "levels_db"]

Levels = NDArray[np.float32]

HALF_HEIGHT_DB = np.float32(20 * math.log10(2))
MIN_BACKGROUND_ROWS = 4
ROWS_BEFORE = 2
"""Rows before the first sample that passes in which a return's half height may lie."""

MIN_SPAN_ROWS = 4
CELL_FRONT = 0.5
"""Rows by which half height is early, because an echo fills a cell and half of it lies before."""

SIDE_LOBE_ROWS = 1
"""Rows beside an echo in which its side lobes may lie."""


@dataclass(frozen=True, slots=True)
class RangeLimits:
    """Range in which returns are searched, and the size of a row."""

    min_range_m: float
    max_range_m: float
    range_resolution_m: float

    def rows(self, of: int) -> slice:
        """Return the slice of rows whose middle lies within the range."""
        first = math.ceil(self.min_range_m / self.range_resolution_m - 0.5)
        end = math.floor(self.max_range_m / self.range_resolution_m + 0.5)
        return slice(min(max(first, 0), of), min(max(end, 0), of))


@dataclass(frozen=True, slots=True, eq=False)
class FirstReturns:
    """First returns of all beams.

    Attributes:
        range_m: (beams,) float64; NaN where there is no return.
        height_db: (beams,) float64, peak of the return above its background; NaN likewise.
    """

    range_m: NDArray[np.float64]
    height_db: NDArray[np.float64]


def first_returns(
    levels: Levels, image: PingImage, limits: RangeLimits, settings: ScanExtractionConfig
) -> FirstReturns:
    """Find the first return of each beam.

    Args:
        levels: (rows, beams) float32 dB above noise.
        image: the image, as displayed.
        limits: range to search.
        settings: thresholds of the tests.
    """
    (rows, beams), intensity = levels.shape, image.intensity
    nothing = np.full(beams, np.nan)
    look = limits.rows(rows)
    if look.stop - look.start < settings.min_run:
        return FirstReturns(nothing, nothing)
    least = np.maximum(_background(levels, look, limits, settings), 0.0)
    least += np.float32(settings.threshold)
    passing = levels[look] > least
    passing &= intensity[look] >= np.float32(settings.min_intensity)
    passing &= levels[look] >= _side_lobes(levels[look], settings)
    found = passing[: len(passing) - settings.min_run + 1].copy()
    for k in range(1, settings.min_run):
        found &= passing[k : k + len(found)]
    first = found.argmax(axis=0)
    beam = np.flatnonzero(found[first, np.arange(beams)])
    place, top_db = _edges(levels, look.start + first[beam], beam, settings)
    range_m, height_db = nothing, nothing.copy()
    range_m[beam] = place * limits.range_resolution_m
    height_db[beam] = top_db - least[first[beam], beam] + settings.threshold
    return FirstReturns(range_m, height_db)


def _background(
    levels: Levels, look: slice, limits: RangeLimits, settings: ScanExtractionConfig
) -> Levels:
    """Return the mean level of the window before each searched sample, without the guard.

    Near the first row the window is shorter.
    """
    guard = max(1, round(settings.guard / limits.range_resolution_m))
    window = max(MIN_BACKGROUND_ROWS, round(settings.window / limits.range_resolution_m))
    summed = _summed(levels[look])
    mean = np.zeros((look.stop - look.start, levels.shape[1]), dtype=np.float32)
    short = min(guard + window, len(mean))
    full = len(mean) - short
    if full > 0:
        np.subtract(summed[window : window + full], summed[:full], out=mean[short : short + full])
        mean[short:] *= np.float32(1 / window)
    for row in range(guard + MIN_BACKGROUND_ROWS, short):
        mean[row] = summed[row - guard] / np.float32(row - guard)
    return mean


def _summed(levels: Levels) -> Levels:
    """Return (rows + 1, beams) sums of all rows before; nine times as fast as np.cumsum."""
    summed = np.empty((len(levels) + 1, levels.shape[1]), dtype=np.float32)
    summed[0] = 0
    for row in range(len(levels)):
        np.add(summed[row], levels[row], out=summed[row + 1])
    return summed


def _side_lobes(levels: Levels, settings: ScanExtractionConfig) -> Levels:
    """Return (rows, 1) the level up to which side lobes of nearby echoes reach."""
    strongest = levels.max(axis=1)
    near = np.pad(strongest, SIDE_LOBE_ROWS, mode="edge")
    widest = np.lib.stride_tricks.sliding_window_view(near, 2 * SIDE_LOBE_ROWS + 1).max(axis=1)
    lobes: Levels = (widest - np.float32(settings.side_lobe_ratio))[:, None]
    return lobes


def _edges(
    levels: Levels, first: NDArray[np.intp], beam: NDArray[np.intp], settings: ScanExtractionConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the position of each return in fractional rows, and the level of its peak.

    A slanted surface rises over the beam's footprint, so the peak is searched over as much range
    as the beam is wide.
    """
    footprint = np.radians(settings.beam_width) * (first + 0.5)
    span = np.maximum(MIN_SPAN_ROWS, np.ceil(footprint)).astype(np.intp)
    offset = np.arange(-ROWS_BEFORE, span.max(initial=MIN_SPAN_ROWS))[:, None]
    row = first + offset
    inside = (row >= 0) & (row < len(levels)) & (offset < span)
    part = np.where(inside, levels[np.clip(row, 0, len(levels) - 1), beam], -np.inf)
    top = part.argmax(axis=0)
    each = np.arange(len(beam))
    top_db = part[top, each].astype(np.float64)
    if settings.place == "peak":
        return row[top, each] + 0.5, top_db
    half_db = top_db - HALF_HEIGHT_DB
    edge = (part >= half_db).argmax(axis=0)
    before_db = np.where(edge > 0, part[np.maximum(edge - 1, 0), each], -np.inf)
    half, at, before = (10 ** (level / 20) for level in (half_db, part[edge, each], before_db))
    early = np.where(edge > 0, (at - half) / np.maximum(at - before, 1e-9), 0.0)
    return row[edge, each] + 0.5 - np.clip(early, 0.0, 1.0) + CELL_FRONT, top_db


MIN_INTENSITY = 0.5
"""Intensity that stands for silence: half a step of 8 bits."""

DB_PER_DECADE = 20.0
LINEAR = (0, 255)
"""Header bytes of images without a gamma exponent."""

EVERY = 8
"""Step of beams and rows on which noise is measured."""

NOISE_BLOCK_M = 0.5
"""Length over which noise is smoothed in range; shorter peaks are not noise."""

MAX_BEAM_GAIN_DB = 6.0


def levels_db(intensity: Levels, gamma_byte: int = 255) -> Levels:
    """Return the levels of an image's amplitudes.

    Args:
        intensity: (rows, beams) float32, 0..255.
        gamma_byte: exponent gamma/255 was applied to the amplitudes; 0 and 255 mean none.

    Returns:
        (rows, beams) float32, dB; the unit is one step of intensity.
    """
    levels = np.maximum(intensity, np.float32(MIN_INTENSITY))
    np.log10(levels, out=levels)
    exponent = 1.0 if gamma_byte in LINEAR else gamma_byte / 255.0
    levels *= np.float32(DB_PER_DECADE / exponent)
    return levels


def equalised(levels: Levels, range_resolution_m: float) -> Levels:
    """Return levels above the noise of their row and beam.

    The noise of a row is the median over its beams, smoothed over range, so that a surface at one
    range in all beams (the wall of a round tank) is kept. The noise of a beam is a low quantile
    over its rows.

    Args:
        levels: (rows, beams) float32 dB.
        range_resolution_m: thickness of a row.

    Returns:
        (rows, beams) float32 dB; noise is around 0.
    """
    rows, beams = levels.shape
    some = levels[:, EVERY // 2 :: EVERY] if beams > EVERY else levels
    middle = some.shape[1] // 2
    profile = np.partition(some, middle, axis=1)[:, middle]
    size = max(3, math.ceil(NOISE_BLOCK_M / range_resolution_m))
    starts = np.arange(0, rows, size)
    medians = [float(np.median(profile[start : start + size])) for start in starts]
    noise = np.interp(np.arange(rows), starts + (size - 1) / 2, medians).astype(np.float32)
    above: Levels = levels - noise[:, None]
    above -= _beam_gains_db(above)
    return above


def _beam_gains_db(above: Levels) -> Levels:
    some = above[EVERY // 2 :: EVERY] if len(above) > EVERY else above
    quarter = len(some) // 4
    quiet = np.partition(some, quarter, axis=0)[quarter]
    gains: Levels = quiet - np.median(quiet)
    return np.clip(gains, -MAX_BEAM_GAIN_DB, MAX_BEAM_GAIN_DB)
