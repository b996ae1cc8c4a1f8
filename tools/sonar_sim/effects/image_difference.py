"""Difference between two pictures of one ping, in the units of a tolerance.

Level: the expected amplitudes (speckle averaged) are compared in dB. What a displacement of no
more than the tolerated part of a cell explains is no difference of level, and what stays within
one step of the quantiser is not seen in a pixel. Where it fills the dark, it is seen in their mean:
peaks of speckle reach a step of which the rms falls short.

Texture: speckled pictures are divided by their expectation; the coefficient of variation of what
remains and its correlation between neighbouring rows and beams are compared.

Displacement: speckle is locked to the surfaces, so it shows where each part of the picture went.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from sonar_sim.scene.sonar import SonarSettings

DARK_STEPS = 2.0
"""Pixels whose expected amplitude is less than this are dark."""
DARK_BANDS, DARK_PART = 8, 0.25
"""Bands of range in which dark pixels are averaged, if they are this part of the band."""
DARK_MEAN = 0.02
"""Steps of the quantiser: a mean pixel below is taken for black."""
DARK_ENTRIES, DARK_LEVELS = 1024, 16
DARK_WEIGHT = 0.5
"""Of a change of the dark's mean against one of a pixel: 1 dB of less than two steps is a quarter
of a step at most."""
CLEAR_CHANGE_DB = 6.0
"""Where single pixels differ by more, the mean of the dark is not looked at."""
MAX_AMPLITUDE = 1e18
"""Limit of amplitude, of full scale: keeps pixels of 32 bits within single precision."""


def level_change_db(
    first: NDArray[np.floating],
    second: NDArray[np.floating],
    sonar: SonarSettings,
    share: float,
    cells: tuple[float, float] = (0.0, 0.0),
    *,
    ignore_dark_shift: bool = False,
) -> float:
    """Difference of level that no more than a share of the pixels exceeds.

    Args:
        first: expected amplitudes of full scale, (rows, beams).
        second: of the other picture.
        sonar: its gamma and bits set the step of the quantiser.
        share: of the pixels.
        cells: displacement that does not count, in rows and in columns.
        ignore_dark_shift: whether that displacement is also ignored in the mean of dark pixels.

    Returns:
        dB, at least 0.
    """
    a, b = (np.minimum(picture, MAX_AMPLITUDE).astype(np.float32) for picture in (first, second))
    change_db = _change_of_pixels_db(a, b, sonar, share, cells)
    if change_db > CLEAR_CHANGE_DB:
        return change_db
    dark_db = dark_change_db(a, b, sonar)
    if ignore_dark_shift:
        # Either picture may be the one that is displaced.
        there = dark_change_db(a, np.clip(a, *_displaced_bounds(b, cells)), sonar)
        dark_db = min(there, dark_change_db(np.clip(b, *_displaced_bounds(a, cells)), b, sonar))
    return max(change_db, DARK_WEIGHT * dark_db)


def _change_of_pixels_db(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    sonar: SonarSettings,
    share: float,
    cells: tuple[float, float],
) -> float:
    """Of pixels that differ by more than a step of the quantiser; as `level_change_db`."""
    exceeding = int(share * a.size)
    _, changes = _beyond(a, b, sonar, (0.0, 0.0))
    if any(cells) and len(changes) > exceeding:
        seen, changes = _beyond(a, b, sonar, cells)
        # Displacing blurs edges, so either picture may be the one that is displaced.
        there, back = (np.zeros(a.shape, dtype=np.float32) for _ in range(2))
        there[seen] = changes
        seen, changes = _beyond(b, a, sonar, cells)
        back[seen] = changes
        changes = np.minimum(there, back).ravel()
    if len(changes) <= exceeding:
        return 0.0
    return float(np.partition(changes, len(changes) - 1 - exceeding)[-1 - exceeding])


def dark_change_db(
    first: NDArray[np.float32], second: NDArray[np.float32], sonar: SonarSettings
) -> float:
    """Largest difference between the means of what is dark in both pictures, over bands of range.

    Of speckle of rms m the pixel is at least k with probability exp(-(t / m)²), t the amplitude
    that is rounded to k; the sum over k is the mean pixel.

    Args:
        first: expected (rms) amplitudes of full scale, (rows, columns).
        second: of the other picture.
        sonar: its gamma and bits set the step of the quantiser.

    Returns:
        dB, at least 0.
    """
    gamma, scale = gamma_of(sonar), full_scale(sonar)
    limit = np.float32((DARK_STEPS / scale) ** (1.0 / gamma))
    dark = (first < limit) & (second < limit)
    rows, columns = dark.shape
    band = rows // DARK_BANDS
    if band == 0 or not dark.any():
        return 0.0
    in_bands = dark[: band * DARK_BANDS].reshape(DARK_BANDS, -1)
    count = np.count_nonzero(in_bands, axis=1)
    table, per_amplitude = _mean_pixels(gamma, scale), np.float32(DARK_ENTRIES) / limit
    levels = []
    for picture in (first, second):
        shown = picture[: band * DARK_BANDS].reshape(DARK_BANDS, -1)
        # What is not dark falls into the table's last entry, which is empty.
        entry = np.where(in_bands, shown * per_amplitude, np.float32(DARK_ENTRIES))
        mean = table[entry.astype(np.int16)].sum(axis=1) / np.maximum(count, 1)
        levels.append(20.0 / gamma * np.log10(np.maximum(mean, DARK_MEAN)))
    change = np.abs(levels[0] - levels[1])[count > DARK_PART * band * columns]
    return float(change.max(initial=0.0))


@lru_cache(maxsize=16)
def _mean_pixels(gamma: float, scale: int) -> NDArray[np.float32]:
    """Mean pixel of speckle over its rms amplitude, 0 to `DARK_STEPS`, then 0, (entries + 1,)."""
    limit = (DARK_STEPS / scale) ** (1.0 / gamma)
    rms = np.maximum(np.arange(DARK_ENTRIES + 1) * (limit / DARK_ENTRIES), 1e-30)
    rounded = ((np.arange(1, DARK_LEVELS + 1) - 0.5) / scale) ** (1.0 / gamma)
    mean: NDArray[np.float32] = np.exp(-np.square(rounded / rms[:, None])).sum(
        axis=1, dtype=np.float32
    )
    mean[-1] = 0.0
    mean.setflags(write=False)
    return mean


def gamma_of(sonar: SonarSettings) -> float:
    """Exponent between amplitude and pixel."""
    return 1.0 if sonar.gamma_byte in (0, 255) else sonar.gamma_byte / 255.0


def full_scale(sonar: SonarSettings) -> int:
    """Largest pixel."""
    return int(2**sonar.bits) - 1


def _beyond(
    amplitude: NDArray[np.float32],
    other: NDArray[np.float32],
    sonar: SonarSettings,
    cells: tuple[float, float],
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """How far amplitudes lie outside of what a small displacement finds in the other, dB.

    Returns:
        Which differ by more than a step of the quantiser, (rows, beams), and by how much.
    """
    nearest = np.clip(amplitude, *_displaced_bounds(other, cells)) if any(cells) else other
    gamma, scale = gamma_of(sonar), full_scale(sonar)
    step = _to_pixel(amplitude, gamma) - _to_pixel(nearest, gamma)
    seen = np.abs(step) * np.float32(scale) > 1.0
    # Half a step is what an integer 0 stands for at most.
    least = np.float32((0.5 / scale) ** (1.0 / gamma))
    a, b = np.maximum(amplitude[seen], least), np.maximum(nearest[seen], least)
    change: NDArray[np.float32] = np.abs(np.float32(20.0) * np.log10(a / b))
    return seen, change


def _to_pixel(amplitude: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Part of the largest pixel; the power costs time, and most sonars are linear."""
    return amplitude if gamma == 1.0 else amplitude ** np.float32(gamma)


def _displaced_bounds(
    picture: NDArray[np.float32], cells: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest amplitude that a displacement up to `cells` brings to each pixel."""
    low = high = np.square(picture)
    for axis, most in enumerate(cells):
        steps = math.ceil(most)
        for _ in range(steps):
            part = np.float32(most / steps)
            low, high = low + part * _fall(low, axis), high - part * _fall(-high, axis)
    return np.sqrt(low), np.sqrt(high)


def _fall(power: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """How far the lower of both neighbours lies under each pixel, 0 or less."""
    step = np.diff(power, axis=axis)
    fall = np.zeros_like(power)
    here, there = _without_end(fall, axis, last=True), _without_end(fall, axis, last=False)
    np.minimum(here, step, out=here)
    np.minimum(there, -step, out=there)
    return fall


def _without_end(picture: NDArray[np.float32], axis: int, *, last: bool) -> NDArray[np.float32]:
    """All rows or columns but the last or the first: a view."""
    part = slice(None, -1) if last else slice(1, None)
    return picture[part] if axis == 0 else picture[:, part]


def expected_clipped(amplitude: NDArray[np.floating]) -> NDArray[np.float32]:
    """Expected amplitude of speckle that is clipped at full scale; unclipped it is as given.

    Peaks are cut before their mean is. Of a Rayleigh law of mean square m²,
    E min(a, 1) = sqrt(pi) / 2 m erf(1 / m).
    """
    m = np.maximum(np.asarray(amplitude, dtype=np.float32), np.float32(1e-6))
    expected: NDArray[np.float32] = (m * erf(np.float32(1.0) / m)).astype(np.float32)
    return expected


def quantiser_change_db(
    amplitude: NDArray[np.floating], sonar: SonarSettings, share: float
) -> float:
    """What rounding does to the level of all but a share of the pixels, dB.

    An amplitude is compared with its pixel, both no less than half a step.
    """
    gamma, scale = gamma_of(sonar), full_scale(sonar)
    pixel = np.clip(np.asarray(amplitude, dtype=np.float64), 0.0, 1.0) ** gamma * scale
    rounded = np.maximum(np.rint(pixel), 0.5)
    change = np.abs(20.0 / gamma * np.log10(rounded / np.maximum(pixel, 0.5)))
    return float(np.quantile(change, 1.0 - share)) if change.size else 0.0


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What a user is ready to overlook.

    Attributes:
        level_db: difference of a pixel's expected level.
        cells: displacement, in rows or beams.
        share: of the picture's pixels, the most that may differ by more than `level_db`; effects
            that cost next to nothing are granted none.
        texture: difference of the speckle's coefficient of variation, or of its correlation
            between neighbouring rows or beams.
        brighter_db: by how much the rules take a ping to be brighter than their coarse picture of
            it, to see how sure they are.
    """

    level_db: float = 0.5
    cells: float = 0.5
    share: float = 0.001
    texture: float = 0.05
    brighter_db: float = 0.0

    def __post_init__(self) -> None:
        """Check that each tolerance is positive, and the share in [0, 1)."""
        if not (self.level_db > 0.0 and self.cells > 0.0 and self.texture > 0.0):
            raise ValueError(f"a tolerance above zero is needed, not {self}")
        if not 0.0 <= self.share < 1.0:
            raise ValueError(f"the share of pixels must be in [0, 1), not {self.share}")
