"""Simple things to look at with a depth camera."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sonar_sim.raycast.depth_camera import Pinhole

FAR_M = 1e4

DepthOf = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Depth along rays (…, 3) in the sonar frame with x = 1; infinite where nothing is."""


def wall(ahead_m: float) -> DepthOf:
    """A plane across the axis."""
    return lambda rays: np.full(rays.shape[:-1], ahead_m)


def floor(below_m: float) -> DepthOf:
    """A level plane under the camera."""

    def depth(rays: NDArray[np.float64]) -> NDArray[np.float64]:
        down = -rays[..., 2]
        meets = down > below_m / FAR_M
        return np.where(meets, below_m / np.where(meets, down, 1.0), np.inf)

    return depth


def sphere(ahead_m: float, radius_m: float) -> DepthOf:
    """A sphere on the axis: nearer root of |t ray - centre| = radius."""

    def depth(rays: NDArray[np.float64]) -> NDArray[np.float64]:
        squared = np.sum(rays * rays, axis=-1)
        root = ahead_m**2 - squared * (ahead_m**2 - radius_m**2)
        nearer = (ahead_m - np.sqrt(np.maximum(root, 0.0))) / squared
        return np.where(root >= 0.0, nearer, np.inf)

    return depth


def seen(camera: Pinhole, *shapes: DepthOf) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Depth image of shapes, 0 where nothing is, and which of them each pixel shows, or -1."""
    depths = np.stack([shape(camera.rays()) for shape in shapes])
    nearest = np.argmin(depths, axis=0)
    depth_m = np.min(depths, axis=0)
    there = (depth_m >= camera.near_m) & (depth_m <= camera.far_m)
    return np.where(there, depth_m, 0.0).astype(np.float32), np.where(there, nearest, -1)
