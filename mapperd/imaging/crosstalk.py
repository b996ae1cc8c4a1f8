"""Stripes out of an image: rings at one range over the whole fan, from another sound source.

Sound that does not come back from a ping arrives at one time in all beams. In the polar image it is
a thin row over the whole fan, which no surface draws: the range of a plane, seen over a fan of half
angle B, changes by the factor 1 / cos B at least. So a row is a stripe where it

- stands out against an opening across the rows (it is thinner than the kernel),
- in each third of the fan, in at least a share of its sectors (it is consistent over the beams),
- and lies so far out that a plane would leave the kernel within the fan: the narrower the fan, the
  farther. Nearer, what may be a stripe is left.

Everything else stays as it is, sample by sample: thin echoes because they do not span the fan,
floors seen flat because they are curved in range or thicker. What cannot be distinguished is a thin
arc around the sonar itself, such as the wall of a round tank with the sonar in its middle.

`without_stripes` does this. `notched` is the notch of sonar_3d_reconstruction's later filter, for
stripes that are thicker than the kernel or do not span the fan. It weakens what is constant over
the beams, where the image's spectrum has the frequency zero over them: stripes, but also all else
that a row has in common. A floor seen flat loses as much as a stripe does.
"""

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import CrosstalkConfig

__all__ = ["notched", "without_stripes"]

SECTORS = 24
"""Of equally many beams, over which speckle is averaged."""

MIN_CONTRAST = 0.25
"""A stripe stands out by this part of the threshold at least: below, hardly a sample passes it."""

RELATIVE_CONTRAST = 0.5
"""And by this part of what is behind it: speckle, averaged over a sector, does not."""

MIN_BEND = 1e-6
"""Below this width of the field of view stripes cannot be detected."""

SHAPES = {"rect": cv2.MORPH_RECT, "ellipse": cv2.MORPH_ELLIPSE, "cross": cv2.MORPH_CROSS}

Image = NDArray[np.float32]


def without_stripes(
    image: Image, bearings_rad: NDArray[np.float64], settings: CrosstalkConfig, threshold: float
) -> Image:
    """Take stripes out of an image.

    Args:
        image: (rows, beams) 0..255, row 0 nearest.
        bearings_rad: (beams,) increasing.
        settings: which rows count as stripes; `enabled` and the notch are the caller's business.
        threshold: intensity above which a sample is a return.

    Returns:
        A new image, nowhere brighter; the image itself where there is no stripe.
    """
    edges = _sector_edges(image.shape[1])
    summed = np.add.reduceat(image, edges[:-1], axis=1)
    mean = (summed / np.diff(edges)).astype(np.float32)
    stands_out = _stands_out(mean, settings, threshold)
    if settings.azimuth_enabled:
        stripe = _over_the_fan(stands_out, bearings_rad, edges, settings.azimuth_threshold)
        stripe[: _first_row(bearings_rad, settings)] = False
        stands_out, edges = stripe[:, None], edges[[0, -1]]
    if not stands_out.any():
        return image
    cleared = image.copy()
    for sector, stripe in enumerate(stands_out.T):
        _bridge(cleared[:, edges[sector] : edges[sector + 1]], stripe)
    return cleared


def _sector_edges(beams: int) -> NDArray[np.intp]:
    return np.linspace(0, beams, min(SECTORS, beams) + 1).round().astype(np.intp)


def _stands_out(mean: Image, settings: CrosstalkConfig, threshold: float) -> NDArray[np.bool_]:
    """Where a sector's row is brighter than what is left of it by the opening across the rows."""
    behind = np.zeros_like(mean)
    if settings.morpho_enabled:
        shape = SHAPES[settings.morpho_kernel_shape]
        kernel = cv2.getStructuringElement(shape, (3, settings.morpho_kernel_size))
        behind = np.asarray(cv2.morphologyEx(mean, cv2.MORPH_OPEN, kernel), dtype=np.float32)
    contrast = np.maximum(MIN_CONTRAST * threshold, RELATIVE_CONTRAST * behind)
    return np.asarray(mean - behind > contrast)


def _over_the_fan(
    stands_out: NDArray[np.bool_],
    bearings_rad: NDArray[np.float64],
    edges: NDArray[np.intp],
    share: float,
) -> NDArray[np.bool_]:
    """Rows that stand out in that share of the sectors of each third of the fan, by angle."""
    middle_rad = bearings_rad[(edges[:-1] + edges[1:]) // 2]
    limits = np.linspace(bearings_rad[0], bearings_rad[-1], 4)[1:3]
    third = np.searchsorted(limits, middle_rad)
    shares = [stands_out[:, third == k].mean(axis=1) for k in range(3) if (third == k).any()]
    return np.asarray(np.min(shares, axis=0) >= share)


def _first_row(bearings_rad: NDArray[np.float64], settings: CrosstalkConfig) -> int:
    """Nearer than this a plane that faces the sonar may look as flat as a stripe.

    To reach the share in the outer thirds it has to be seen up to some angle; by then its range
    must have changed by more than a kernel.
    """
    half_rad = float(bearings_rad[-1] - bearings_rad[0]) / 2
    seen_rad = half_rad * (1 + 2 * settings.azimuth_threshold) / 3
    bend = 1 / max(math.cos(seen_rad), MIN_BEND) - 1
    return math.ceil((settings.morpho_kernel_size + 1) / max(bend, MIN_BEND))


def _bridge(image: Image, stripe: NDArray[np.bool_]) -> None:
    """Put what lies before and behind each run of rows in their place, where that is darker."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], stripe, [False]))))
    for first, end in edges.reshape(-1, 2):
        near = image[first - 1] if first > 0 else 0.0
        far = image[end] if end < len(image) else 0.0
        part = (np.arange(1, end - first + 1, dtype=np.float32) / (end - first + 1))[:, None]
        np.minimum(image[first:end], near + (far - near) * part, out=image[first:end])


MIN_SIDE = 4
"""Images smaller than this have no spectrum to speak of."""

MIN_KEPT = 2.0
"""Frequencies over the rows that are kept at least: the image's slow changes."""

FULL_SCALE = 255.0


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
