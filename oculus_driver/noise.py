"""Level of the noise in a ping's image, and which samples are echoes.

A fixed threshold lies below the far noise of one sonar and above the weak echoes of another: gain
and the gain over time that compensates spreading differ. The noise is measured in each image.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["is_echo", "noise_by_range"]

BANDS = 16
QUANTILE = 0.25
"""Of the samples of a band; surfaces may fill the rest."""
STRIDE = 4
"""Every so many rows and beams are enough."""


def noise_by_range(image: ArrayLike) -> NDArray[np.float32]:
    """Estimate the level of the noise by range.

    A low quantile of each of 16 bands of range; where a farther band is quieter, that one counts,
    since surfaces may fill a band and noise does not fall with range.

    Args:
        image: (rows, beams) amplitudes, row 0 nearest.

    Returns:
        (rows,) a quarter of the samples of noise lie below; of the unit of the image.

    Raises:
        ValueError: it is no image, or has no sample.
    """
    samples = np.asarray(image)
    if samples.ndim != 2 or samples.size == 0:  # noqa: PLR2004 rows and beams
        raise ValueError(f"an image of shape {samples.shape} has no noise; expected (rows, beams)")
    rows = len(samples)
    bands = np.array_split(np.arange(rows), min(BANDS, rows))
    stride = min(STRIDE, max(1, rows // BANDS))
    chosen = [band[::stride] for band in bands]
    levels = np.empty(len(bands))
    for length in {len(some) for some in chosen}:  # of all bands alike at once: much faster
        alike = [i for i, some in enumerate(chosen) if len(some) == length]
        these = samples[np.concatenate([chosen[i] for i in alike]), ::STRIDE]
        levels[alike] = np.quantile(these.reshape(len(alike), -1), QUANTILE, axis=1)
    levels = np.minimum.accumulate(levels[::-1])[::-1]
    middles = [band.mean() for band in bands]
    found: NDArray[np.float32] = np.interp(np.arange(rows), middles, levels).astype(np.float32)
    return found


def is_echo(image: ArrayLike, factor: float) -> NDArray[np.bool_]:
    """Find the samples that are echoes: above `factor` times the noise of `noise_by_range`.

    Args:
        image: (rows, beams) amplitudes, row 0 nearest.
        factor: 7 finds one false echo in a million samples of Rayleigh noise.

    Returns:
        (rows, beams).

    Raises:
        ValueError: as `noise_by_range`.
    """
    found: NDArray[np.bool_] = np.asarray(image) > factor * noise_by_range(image)[:, np.newaxis]
    return found
