"""The sonar's image: as it comes, and bent into the shape of the fan."""

import math

import numpy as np
from foxglove.messages import RawImage
from numpy.typing import NDArray

from mapperd.foxglove.geometry import stamp
from mapperd.wire.messages import Image

__all__ = ["FanShape", "polar_image"]


def polar_image(pixels: NDArray[np.uint8], frame: str, stamp_ns: int) -> RawImage:
    """Grey values as an image of its own."""
    height, width = pixels.shape
    return RawImage(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="mono8",
        step=width,
        data=pixels.tobytes(),
    )


class FanShape:
    """Bends images; what it takes for that is kept while their shape stays."""

    def __init__(self) -> None:
        self._shape: tuple[int, int, bytes] | None = None
        self._source = np.zeros((0, 0), np.intp)

    def bent(self, image: Image, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Seen from above: the sonar below in the middle, port to the left; black outside.

        Args:
            image: whose bearings they are.
            pixels: (rows, beams).
        """
        shape = (image.rows, image.beams, image.bearings_rad)
        if shape != self._shape:
            self._source = _source(image)
            self._shape = shape
        return np.append(pixels.ravel(), np.uint8(0))[self._source]


def _source(image: Image) -> NDArray[np.intp]:
    """Which of the image's values each pixel shows; the one after the last is outside."""
    rows, beams = image.rows, image.beams
    bearings = np.frombuffer(image.bearings_rad, "<f4").astype(np.float64)
    low, high = _edges(bearings)
    widest = min(max(abs(low), abs(high)), math.pi / 2)
    half_width = max(math.ceil(rows * math.sin(widest)), 1)
    across = np.arange(-half_width, half_width) + 0.5
    ahead = (np.arange(rows) + 0.5)[::-1, None]
    row = np.floor(np.hypot(across, ahead)).astype(np.intp)
    bearing = np.arctan2(across, ahead)
    between = (bearings[1:] + bearings[:-1]) / 2
    beam = np.searchsorted(between, bearing)
    seen = (row < rows) & (bearing >= low) & (bearing <= high)
    return np.where(seen, row * beams + beam, rows * beams)


def _edges(bearings: NDArray[np.float64]) -> tuple[float, float]:
    """The outer beams are as wide as half the way to their neighbours."""
    if len(bearings) == 1:
        return float(bearings[0]) - 0.01, float(bearings[0]) + 0.01
    low = bearings[0] - (bearings[1] - bearings[0]) / 2
    high = bearings[-1] + (bearings[-1] - bearings[-2]) / 2
    return float(low), float(high)
