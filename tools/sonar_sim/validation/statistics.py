"""Statistics of pictures, the same for simulated ones and recorded ones.

Amplitudes are (rows, beams), any unit; pixels are 8-bit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BLOCK = 16
"""Rows and beams of a block within which the mean level is taken as even. Beams and rows share
speckle, so a block of 10 holds some 30 independent cells, whose mean hides 3 % of their spread; a
block of 16 holds three times as many."""
FINE_BLOCK = 6
"""The same for correlation between pings: a scene's own shape within a block stays, too, and would
count as speckle."""
FLAT = 0.07
"""Halves of a block may differ from it by this part in mean level to be called flat."""
FLAT_PIXELS = (20.0, 200.0)
"""Mean pixel of blocks for speckle statistics: above the noise, below saturation."""

Amplitude = NDArray[np.float64]


def linear_amplitude(pixels: NDArray[np.uint8], gamma_byte: int) -> Amplitude:
    """Undo the pixel law: parts of full scale."""
    exponent = 1.0 if gamma_byte == 0 else 255.0 / gamma_byte
    amplitude: Amplitude = (pixels / 255.0) ** exponent
    return amplitude


def blocks(picture: NDArray[np.float64], side: int = BLOCK) -> NDArray[np.float64]:
    """Cut (rows, beams) into (N, side, side); what is left over at the ends is dropped."""
    rows, beams = (size // side for size in picture.shape)
    cut = picture[: rows * side, : beams * side].reshape(rows, side, beams, side)
    return cut.transpose(0, 2, 1, 3).reshape(-1, side, side)


def flat_blocks(pixels: NDArray[np.uint8], gamma_byte: int) -> NDArray[np.float64]:
    """Amplitudes of blocks without a trend or saturation, each over its mean, (N, BLOCK, BLOCK)."""
    raw = blocks(pixels.astype(np.float64))
    amplitude = blocks(linear_amplitude(pixels, gamma_byte))
    mean = np.maximum(amplitude.mean(axis=(1, 2)), 1e-12)
    half = BLOCK // 2
    halves = np.stack(
        [
            amplitude[:, :half].mean(axis=(1, 2)),
            amplitude[:, half:].mean(axis=(1, 2)),
            amplitude[:, :, :half].mean(axis=(1, 2)),
            amplitude[:, :, half:].mean(axis=(1, 2)),
        ]
    )
    level = raw.mean(axis=(1, 2))
    even = np.abs(halves / mean - 1.0).max(axis=0) < FLAT
    usable = even & (level > FLAT_PIXELS[0]) & (level < FLAT_PIXELS[1])
    usable &= raw.max(axis=(1, 2)) < 254  # noqa: PLR2004 the quantiser's end
    relative: NDArray[np.float64] = amplitude[usable] / mean[usable, None, None]
    return relative


@dataclass(frozen=True, slots=True)
class Speckle:
    """Shape of a distribution of amplitudes; see `RAYLEIGH` for fully developed speckle.

    Attributes:
        cv: standard deviation over mean.
        skewness, excess_kurtosis: third and fourth standardised moments, the latter less 3.
        median: over mean.
        above_2, above_3: probability of twice and three times the mean.
        power_cv: of the amplitude's square.
        level_std_db: of the level.
        level_bias_db: mean of the level less the level of the mean power.
        rayleigh_distance: Kolmogorov's, to the Rayleigh distribution of equal power.
    """

    cv: float
    skewness: float
    excess_kurtosis: float
    median: float
    above_2: float
    above_3: float
    power_cv: float
    level_std_db: float
    level_bias_db: float
    rayleigh_distance: float


RAYLEIGH = Speckle(0.5227, 0.6311, 0.2451, 0.9394, 0.0432, 8.5e-4, 1.0, 5.570, -2.507, 0.0)


def speckle(amplitude: NDArray[np.floating]) -> Speckle:
    """Measure the shape of a sample, any shape of array; zeros count as the faintest level."""
    a = np.sort(amplitude.astype(np.float64).ravel())
    a /= a.mean()
    z = (a - 1.0) / a.std()
    power = np.square(a)
    level_db = 10.0 * np.log10(np.maximum(power, 1e-9))
    rayleigh = -np.expm1(-power / power.mean())
    steps = np.arange(len(a) + 1) / len(a)
    distance = max(np.max(steps[1:] - rayleigh), np.max(rayleigh - steps[:-1]))
    return Speckle(
        cv=float(a.std()),
        skewness=float(np.mean(z**3)),
        excess_kurtosis=float(np.mean(z**4)) - 3.0,
        median=float(np.median(a)),
        above_2=float(np.mean(a > 2.0)),  # noqa: PLR2004
        above_3=float(np.mean(a > 3.0)),  # noqa: PLR2004
        power_cv=float(power.std() / power.mean()),
        level_std_db=float(level_db.std()),
        level_bias_db=float(level_db.mean() - 10.0 * math.log10(power.mean())),
        rayleigh_distance=float(distance),
    )


def correlation(one: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    """Pearson's, over all elements."""
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def fluctuation(amplitude: Amplitude, side: int = BLOCK) -> NDArray[np.float64]:
    """Each block over its mean, less 1, (N, side, side)."""
    cut = blocks(amplitude, side)
    mean = np.maximum(cut.mean(axis=(1, 2), keepdims=True), 1e-12)
    relative: NDArray[np.float64] = cut / mean - 1.0
    return relative


def beam_correlation(amplitude: Amplitude, lag: int = 1, side: int = BLOCK) -> float:
    """Of amplitudes at beams `lag` apart, the level of each block taken out."""
    f = fluctuation(amplitude, side)
    return correlation(f[:, :, :-lag], f[:, :, lag:])


def row_correlation(amplitude: Amplitude, lag: int = 1, side: int = BLOCK) -> float:
    """Of amplitudes at rows `lag` apart, the level of each block taken out."""
    f = fluctuation(amplitude, side)
    return correlation(f[:, :-lag], f[:, lag:])


def ping_correlation(pings: Sequence[Amplitude]) -> float:
    """Mean over pairs of pings, the level of each block taken out."""
    parts = [fluctuation(ping, FINE_BLOCK) for ping in pings]
    pairs = [(a, b) for i, a in enumerate(parts) for b in parts[i + 1 :]]
    return float(np.mean([correlation(a, b) for a, b in pairs]))


def class_correlation(
    pings: Sequence[Amplitude], pixels: Sequence[NDArray[np.uint8]], low: float, high: float
) -> float:
    """As `ping_correlation`, of blocks whose mean pixel lies in [low, high)."""
    level = np.mean([blocks(p.astype(np.float64), FINE_BLOCK) for p in pixels], axis=(0, 2, 3))
    chosen = (level >= low) & (level < high)
    parts = [fluctuation(ping, FINE_BLOCK)[chosen] for ping in pings]
    pairs = [(a, b) for i, a in enumerate(parts) for b in parts[i + 1 :]]
    return float(np.mean([correlation(a, b) for a, b in pairs]))


def noise_power(pings: Sequence[Amplitude], rows_per_band: int) -> NDArray[np.float64]:
    """Mean power of the noise under echoes that stay from ping to ping, (bands,).

    Echo and noise of powers S and N make Rayleigh amplitudes of power T = S + N, whose correlation
    between pings is (S / T)², and whose variance is (1 - pi/4) T. Half the mean square difference
    of two pings is thus (1 - pi/4) D with D = T - S² / T, and N = T - sqrt(T² - T D).
    """
    bands = pings[0].shape[0] // rows_per_band

    def banded(picture: Amplitude) -> NDArray[np.float64]:
        means: NDArray[np.float64] = (
            picture[: bands * rows_per_band].reshape(bands, -1).mean(axis=1)
        )
        return means

    power = np.mean([banded(np.square(ping)) for ping in pings], axis=0)
    gaps = [
        0.5 * banded(np.square(one - other))
        for i, one in enumerate(pings)
        for other in pings[i + 1 :]
    ]
    changing = np.minimum(np.mean(gaps, axis=0) / (1.0 - math.pi / 4.0), power)
    noise: NDArray[np.float64] = power - np.sqrt(power * (power - changing))
    return noise
