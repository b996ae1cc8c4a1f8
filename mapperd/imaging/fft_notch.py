"""The notch of the published mapper's later filter: less of what is constant over the beams.

Stripes are horizontal lines of the image, so all they are in its spectrum lies where the frequency
over the beams is zero. So is everything else that a row has in common: a floor seen flat loses as
much as a stripe does. `mapperd.imaging.crosstalk` distinguishes them; this is for stripes that are
thicker than its kernel or do not span the fan.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import CrosstalkConfig

__all__ = ["notched"]

MIN_SIDE = 4
"""Images smaller than this have no spectrum to speak of."""

MIN_KEPT = 2.0
"""Frequencies over the rows that are kept at least: the image's slow changes."""

FULL_SCALE = 255.0

Image = NDArray[np.float32]


def notched(image: Image, settings: CrosstalkConfig) -> Image:
    """Weaken what is constant over the beams.

    Args:
        image: (rows, beams) 0..255; returned as it is if a side is under four samples.
        settings: width, strength and what is kept.
    """
    if min(image.shape) < MIN_SIDE:
        return image
    kept = _mask(
        image.shape, settings.filter_width, settings.filter_strength, settings.dc_preserve_ratio
    )
    spectrum = np.fft.rfft2(image)
    spectrum *= kept
    cleared = np.fft.irfft2(spectrum, s=image.shape)
    return np.clip(cleared, 0.0, FULL_SCALE).astype(np.float32)


@functools.lru_cache(maxsize=4)
def _mask(shape: tuple[int, int], width: float, strength: float, dc_ratio: float) -> Image:
    """Factor of each frequency, (rows, beams // 2 + 1)."""
    rows, beams = shape
    over_beams = np.fft.rfftfreq(beams)[None, :] * 2  # of the highest frequency
    over_rows = np.fft.fftfreq(rows)[:, None] * rows  # whole waves in the image
    stripe = np.exp(-((over_beams / width) ** 2) / 2)
    kept_rows = max(MIN_KEPT, dc_ratio * rows / 2)
    changing = 1 - np.exp(-((over_rows / kept_rows) ** 2) / 2)
    mask = np.clip(1 - strength * stripe * changing, 0, 1).astype(np.float32)
    mask.setflags(write=False)
    return np.asarray(mask)
