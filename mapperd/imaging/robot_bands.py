"""Detects other robots in an image by their brightness."""

import cv2
import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import RobotDetectionConfig, TerrainDetectionConfig
from mapperd.imaging.robots import Robot

__all__ = ["MAX_ROBOTS", "find_robots", "terrain_of"]

MAX_ROBOTS = 64
"""Of one ping, the largest; an image full of them is no image of robots."""

Image = NDArray[np.float32]
Ints = NDArray[np.intp]


def find_robots(
    image: Image,
    bearings_rad: NDArray[np.float64],
    range_resolution_m: float,
    settings: RobotDetectionConfig,
) -> list[Robot]:
    """Find groups of samples from `min_threshold` on, at least `min_samples` that touch.

    Args:
        image: (rows, beams) 0..255, row 0 nearest.
        bearings_rad: (beams,) increasing.
        range_resolution_m: thickness of a row.
        settings: what is a robot.

    Returns:
        The largest `MAX_ROBOTS`, largest first.
    """
    rows, beams, label, numbers = _groups(image, settings)
    intensity = image[rows, beams].astype(np.float64)
    count = int(label.max(initial=0)) + 1
    weight = np.bincount(label, intensity, count)
    range_m = np.bincount(label, intensity * (rows + 0.5), count) * range_resolution_m
    bearing = np.bincount(label, intensity * bearings_rad[beams], count)
    peak = np.zeros(count)
    np.maximum.at(peak, label, intensity)
    return [
        Robot(float(range_m[k] / weight[k]), float(bearing[k] / weight[k]), samples, float(peak[k]))
        for k, samples in numbers[:MAX_ROBOTS]
    ]


def terrain_of(
    image: Image, terrain: TerrainDetectionConfig, robots: RobotDetectionConfig
) -> Image:
    """What the map is to see: terrain, and robots unless they are kept out; the rest is 0.

    Samples as bright as robots, but in groups too small for one, are terrain.

    Args:
        image: (rows, beams) 0..255.
        terrain: its intensities.
        robots: theirs, and whether the map has them.
    """
    kept = (image >= terrain.min_threshold) & (image < terrain.max_threshold)
    seen = np.where(kept, image, np.float32(0))
    rows, beams, label, _ = _groups(image, robots)
    of_robot = (label > 0) & robots.keep_out
    seen[rows, beams] = np.where(of_robot, np.float32(0), image[rows, beams])
    return seen


def _groups(
    image: Image, settings: RobotDetectionConfig
) -> tuple[Ints, Ints, Ints, list[tuple[int, int]]]:
    """Rows and beams of the samples bright enough, the robot of each by label, and their sizes.

    Label 0 marks groups that are too small. Sizes are by label, the largest first.
    """
    bright = (image >= settings.min_threshold) & (image > 0)  # silence weighs nothing
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        bright.view(np.uint8), connectivity=8
    )
    sizes = stats[:, cv2.CC_STAT_AREA]
    large = sizes >= settings.min_samples
    large[0] = False
    rows, beams = np.nonzero(bright)
    label = np.where(large, np.arange(count), 0)[labels[rows, beams]]
    order = sorted(np.flatnonzero(large), key=lambda k: (-int(sizes[k]), int(k)))
    return rows, beams, label, [(int(k), int(sizes[k])) for k in order]
