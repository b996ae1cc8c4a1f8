"""Difference between two pictures of one ping, in the units of a tolerance.

Level: the expected amplitudes (speckle averaged) are compared in dB. What a displacement of no
more than the tolerated part of a cell explains is no difference of level, and what stays within
one step of the quantiser is not seen in a pixel. Where it fills the dark, it is seen in their mean:
peaks of speckle reach a step of which the rms falls short.

Texture: speckled pictures are divided by their expectation; the coefficient of variation of what
remains and its correlation between neighbouring rows and beams are compared.

Displacement: speckle is locked to the surfaces, so it shows where each part of the picture went.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from sonar_sim import _core
from sonar_sim.scene.sonar import SonarSettings

DARK_STEPS = 2.0
"""Pixels whose expected amplitude is less than this are dark."""
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
    limit: float = MAX_AMPLITUDE,
    brighter: float = 1.0,
) -> float:
    """Difference of level that no more than a share of the pixels exceeds.

    Args:
        first: expected amplitudes of full scale, (rows, beams).
        second: of the other picture.
        sonar: its gamma and bits set the step of the quantiser.
        share: of the pixels.
        cells: displacement that does not count, in rows and in columns.
        ignore_dark_shift: whether that displacement is also ignored in the mean of dark pixels.
        limit: of the amplitudes: what is larger counts as this.
        brighter: factor to amplitudes so limited.

    Returns:
        dB, at least 0.
    """
    a, b = (_core.limited(picture, limit, brighter) for picture in (first, second))
    gamma, scale = gamma_of(sonar), full_scale(sonar)
    change_db = _core.pixel_change_db(a, b, gamma, scale, int(share * a.size), *cells)
    if change_db > CLEAR_CHANGE_DB:
        return change_db
    ignored = cells if ignore_dark_shift else (0.0, 0.0)
    dark_db = _core.dark_change_db(a, b, gamma, *_mean_pixels(gamma, scale), *ignored)
    return max(change_db, DARK_WEIGHT * dark_db)


@lru_cache(maxsize=16)
def _mean_pixels(gamma: float, scale: int) -> tuple[NDArray[np.float32], float]:
    """Mean pixel of speckle over its rms amplitude, up to the largest that is dark.

    Of speckle of rms m the pixel is at least k with probability exp(-(t / m)²), t the amplitude
    that is rounded to k; the sum over k is the mean pixel.

    Returns:
        Means at rms amplitudes from 0 to a limit, evenly spaced, then a 0, (entries + 1,). And the
        limit, of full scale.
    """
    limit = (DARK_STEPS / scale) ** (1.0 / gamma)
    rms = np.maximum(np.arange(DARK_ENTRIES + 1) * (limit / DARK_ENTRIES), 1e-30)
    rounded = ((np.arange(1, DARK_LEVELS + 1) - 0.5) / scale) ** (1.0 / gamma)
    mean: NDArray[np.float32] = np.exp(-np.square(rounded / rms[:, None])).sum(
        axis=1, dtype=np.float32
    )
    mean[-1] = 0.0
    mean.setflags(write=False)
    return mean, limit


def gamma_of(sonar: SonarSettings) -> float:
    """Exponent between amplitude and pixel."""
    return 1.0 if sonar.gamma_byte in (0, 255) else sonar.gamma_byte / 255.0


def full_scale(sonar: SonarSettings) -> int:
    """Largest pixel."""
    return int(2**sonar.bits) - 1


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
