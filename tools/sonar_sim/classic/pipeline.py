"""The published plugin's pipeline: depth image, normals, signal-to-noise ratio."""

import math
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sonar_sim.classic import scan
from sonar_sim.raycast.depth_camera import Pinhole

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


SOURCE_LEVEL_DB = 200.0
NOISE_LEVEL_DB = 30.0
DIRECTIVITY_DB = 0.0
TARGET_STRENGTH_DB = 100.0
"""Of the third channel of the "normals" at 1."""
LOSS_DB_PER_M = 5.0
"""One way, in place of spreading and absorption."""


def level_db(
    depth_m: NDArray[np.float32],
    third_channel: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Signal over noise before the frame's own gain: 170 - 10 R + 100 n, nothing below 0.

    Args:
        depth_m: (height, width) along the axis.
        third_channel: of the stretched "normals", (height, width).
        x: of each column in units of the focal length, (width,).
        y: of each row, (height,).
    """
    slant = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + np.float32(1.0))
    loss_db = np.float32(LOSS_DB_PER_M) * depth_m * slant
    gain_db = np.float32(SOURCE_LEVEL_DB - (NOISE_LEVEL_DB - DIRECTIVITY_DB))
    with np.errstate(invalid="ignore"):
        snr_db = gain_db - 2.0 * loss_db + np.float32(TARGET_STRENGTH_DB) * third_channel
        snr_db[snr_db < 0.0] = 0.0
    result: NDArray[np.float32] = snr_db.astype(np.float32)
    return result


def snr(
    depth_m: NDArray[np.float32],
    third_channel: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Stretch the levels to 0 .. 1 over this frame, (height, width)."""
    return stretched(level_db(depth_m, third_channel, x, y))


HORIZONTAL_RAD = 1.54719755
"""Field of view of the plugin's example, 88.65°."""
CLOUD_FROM_M = 0.4
"""Nearer points are left out of its point cloud."""


def classic_camera(width: int = 760, height: int = 169, far_m: float = scan.RANGE_M) -> Pinhole:
    """The depth camera of the plugin's example: 88.65°, clipped at 0.1 and 17 m."""
    return Pinhole(width, height, HORIZONTAL_RAD, near_m=0.1, far_m=far_m)


@dataclass(frozen=True, slots=True, eq=False)
class ClassicImages:
    """What the plugin publishes for one frame.

    Attributes:
        depth_m: float32 (height, width), 0 where nothing is.
        normals: float32 (height, width, 3), 0 to 1.
        snr: float32 (height, width), 0 to 1.
        raw_scan: float32 (rows, columns).
        fan: uint8 (rows, columns, 3), red first.
    """

    depth_m: NDArray[np.float32] = field(repr=False)
    normals: NDArray[np.float32] = field(repr=False)
    snr: NDArray[np.float32] = field(repr=False)
    raw_scan: NDArray[np.float32] = field(repr=False)
    fan: NDArray[np.uint8] = field(repr=False)


def places(
    shape: tuple[int, ...], focal_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Place of each column and row over the focal length, as the plugin has them.

    Its principal point is ((W + 1) / 2, (H + 1) / 2), with the first pixel at 0: one pixel beside
    the camera's axis.
    """
    height, width = shape[:2]
    x = (np.arange(width) - (width + 1) / 2.0) / focal_px
    y = (np.arange(height) - (height + 1) / 2.0) / focal_px
    return x.astype(np.float32), y.astype(np.float32)


def classic_images(
    depth_m: NDArray[np.float32],
    horizontal_rad: float = HORIZONTAL_RAD,
    generator: np.random.Generator | None = None,
    *,
    rows: int = scan.ROWS,
    range_m: float = scan.RANGE_M,
) -> ClassicImages:
    """Run the plugin's pipeline.

    Args:
        depth_m: float32 (height, width), along the axis; 0 where nothing is.
        horizontal_rad: field of view across.
        generator: of its speckle; a fixed one if none is given. The draws are ours, not those of
            the C++ library that the plugin was built with.
        rows: of the plan view; 400 in the plugin.
        range_m: that the rows cover; 17 m in the plugin.
    """
    focal_px = depth_m.shape[1] / (2.0 * math.tan(horizontal_rad / 2.0))
    x, y = places(depth_m.shape, focal_px)
    bent = normals(depth_m, focal_px)
    levels = snr(depth_m, bent[..., 2], x, y)
    empty = scan.sector_mask(horizontal_rad, rows)
    strewn = scan.projected(depth_m, levels, x, y, empty, range_m=range_m)
    raw = scan.speckled(scan.blurred(strewn), generator or np.random.default_rng(1))
    return ClassicImages(depth_m, bent, levels, raw, scan.picture(raw, horizontal_rad))
