"""The first stage: gradients of the depth image, called normals."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DOWN = np.array([[-1, -2, -1], [0, 0, 0], [1, 2, 1]], dtype=np.float32) / 8.0
"""Sobel's kernel for the gradient from row to row."""


def gradients(depth_m: NDArray[np.float32], focal_px: float) -> NDArray[np.float32]:
    """Depth's gradients and depth over focal length, as unit triples.

    The gradients are of metres from pixel to pixel, which are no slopes: what a pixel's own place
    in the picture adds is left out.

    Args:
        depth_m: (height, width) along the axis, 0 where nothing is.
        focal_px: focal length.

    Returns:
        (height, width, 3): down, across, ahead.
    """
    down = _filtered(depth_m, DOWN)
    across = _filtered(depth_m, DOWN.T)
    nothing = cv2.erode(
        np.uint8(255) * (depth_m == 0.0).astype(np.uint8),
        np.ones((3, 3), dtype=np.uint8),
        iterations=2,
        borderType=cv2.BORDER_REPLICATE,
        borderValue=(1.0,),
    )
    down[nothing > 0] = 0.0
    across[nothing > 0] = 0.0
    triple = np.stack([down, across, depth_m / np.float32(focal_px)], axis=-1)
    length = np.linalg.norm(triple, axis=-1, keepdims=True)
    unit: NDArray[np.float32] = np.divide(
        triple, length, out=np.zeros_like(triple), where=length != 0.0
    )
    return unit


def normals(depth_m: NDArray[np.float32], focal_px: float) -> NDArray[np.float32]:
    """Stretch each channel to its own least and greatest value in this frame, (h, w, 3)."""
    unit = gradients(depth_m, focal_px)
    channels = [stretched(unit[..., index]) for index in range(3)]
    return np.stack(channels, axis=-1)


def stretched(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Map least to 0 and greatest to 1; NaN where they are equal, as in the original."""
    least, greatest, _, _ = cv2.minMaxLoc(np.ascontiguousarray(image))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = np.float32(np.float64(1.0) / np.float64(greatest - least))
        result: NDArray[np.float32] = (image - np.float32(least)) * scale
    return result


def _filtered(image: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[Any]:
    return cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE)
