"""Levels of an image in decibels, and the noise in it taken off."""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["equalised", "levels_db"]

Levels = NDArray[np.float32]

LEAST_INTENSITY = 0.5
"""Half a step of 8 bits stands for silence."""

DB_PER_DECADE = 20.0
LINEAR = (0, 255)
"""Bytes that say that no exponent was applied to an image."""

EVERY = 8
"""Noise is measured on every so many beams or rows."""

NOISE_BLOCK_M = 0.5
"""Noise over range is smooth: a row that stands out of this much is no noise."""

MOST_BEAM_GAIN_DB = 6.0


def levels_db(intensity: Levels, gamma_byte: int = 255) -> Levels:
    """Levels of an image's amplitudes.

    Args:
        intensity: (rows, beams) float32, 0..255.
        gamma_byte: exponent gamma/255 was applied to the amplitudes; 0 and 255 mean none.

    Returns:
        (rows, beams) float32, dB; the unit is one step of intensity.
    """
    levels = np.maximum(intensity, np.float32(LEAST_INTENSITY))
    np.log10(levels, out=levels)
    exponent = 1.0 if gamma_byte in LINEAR else gamma_byte / 255.0
    levels *= np.float32(DB_PER_DECADE / exponent)
    return levels


def equalised(levels: Levels, range_resolution_m: float) -> Levels:
    """Levels above the noise, by what range and beam have of it.

    The noise of a row is the median over its beams, smoothed over range: a surface at one range in
    all beams, as a round tank's wall is, stays. That of a beam is a low quantile over its rows.

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
    return np.clip(gains, -MOST_BEAM_GAIN_DB, MOST_BEAM_GAIN_DB)
