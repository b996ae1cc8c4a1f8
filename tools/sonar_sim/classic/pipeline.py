"""All four stages, from a depth image to the five pictures that the plugin publishes."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sonar_sim.classic import normals as first
from sonar_sim.classic import scan as third
from sonar_sim.classic import snr as second
from sonar_sim.classic import visual as fourth
from sonar_sim.raycast.depth_camera import Pinhole

HORIZONTAL_RAD = 1.54719755
"""Field of view of the plugin's example, 88.65°."""
CLOUD_FROM_M = 0.4
"""Nearer points are left out of its point cloud."""


def classic_camera(width: int = 760, height: int = 169) -> Pinhole:
    """The depth camera of the plugin's example: 88.65°, clipped at 0.1 and 17 m."""
    return Pinhole(width, height, HORIZONTAL_RAD, near_m=0.1, far_m=17.0)


@dataclass(frozen=True, slots=True, eq=False)
class ClassicImages:
    """What the plugin publishes for one frame.

    Attributes:
        depth_m: float32 (height, width), 0 where nothing is.
        normals: float32 (height, width, 3), 0 to 1.
        snr: float32 (height, width), 0 to 1.
        raw_scan: float32 (400, columns).
        fan: uint8 (400, columns, 3), red first.
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
) -> ClassicImages:
    """Run the plugin's pipeline.

    Args:
        depth_m: float32 (height, width), along the axis; 0 where nothing is.
        horizontal_rad: field of view across.
        generator: of its speckle; a fixed one if none is given. The draws are ours, not those of
            the C++ library that the plugin was built with.
    """
    focal_px = depth_m.shape[1] / (2.0 * math.tan(horizontal_rad / 2.0))
    x, y = places(depth_m.shape, focal_px)
    bent = first.normals(depth_m, focal_px)
    snr = second.snr(depth_m, bent[..., 2], x, y)
    strewn = third.strewn(depth_m, snr, x, y, third.pie(horizontal_rad))
    raw = third.speckled(third.broadened(strewn), generator or np.random.default_rng(1))
    return ClassicImages(depth_m, bent, snr, raw, fourth.picture(raw, horizontal_rad))
