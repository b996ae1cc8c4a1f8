"""Other robots in an image, detected by their brightness, and a memory of the recent ones.

Detection needs OpenCV, of the extra `filters`.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import RobotDetectionConfig, TerrainDetectionConfig

__all__ = [
    "MAX_ROBOTS",
    "MAX_SIGHTINGS",
    "Point",
    "Robot",
    "Sighting",
    "Sightings",
    "find_robots",
    "terrain_of",
]

Point = tuple[float, float, float]
"""Metres."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Touching samples that are as bright as robots are.

    Attributes:
        range_m: of their centre, weighted by intensity.
        bearing_rad: the same; positive to starboard.
        samples: how many they are.
        peak: the brightest of them, 0..255.
    """

    range_m: float
    bearing_rad: float
    samples: int
    peak: float

    def position_m(self, map_T_sonar: NDArray[np.float64]) -> Point:  # noqa: N803 frames are named
        """Position in the map at zero elevation, which images do not resolve."""
        x_m = self.range_m * math.cos(self.bearing_rad)
        y_m = -self.range_m * math.sin(self.bearing_rad)
        x, y, z = (map_T_sonar @ (x_m, y_m, 0.0, 1.0))[:3]
        return float(x), float(y), float(z)


MAX_SIGHTINGS = 4096
"""Beyond this the oldest go before their time."""

SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Sighting:
    """A robot, when and where.

    Attributes:
        t_ns: of the ping's arrival.
        position_m: (x, y, z) in the map, in the middle of the vertical aperture.
        robot: as the sonar saw it.
    """

    t_ns: int
    position_m: Point
    robot: Robot


class Sightings:
    """Sightings of the last seconds.

    Attributes:
        crowded_out: sightings that were forgotten before their time.
    """

    def __init__(self) -> None:
        self.crowded_out = 0
        self._seen: deque[Sighting] = deque()

    def add(self, sightings: Iterable[Sighting]) -> None:
        """Remember these."""
        for sighting in sightings:
            if len(self._seen) == MAX_SIGHTINGS:
                self._seen.popleft()
                self.crowded_out += 1
            self._seen.append(sighting)

    def since(self, now_ns: int, expire_s: float) -> list[Sighting]:
        """Forget what is older, and what a clock set back has left in the future; oldest first.

        Args:
            now_ns: on the clock of the arrivals.
            expire_s: `robot_detection.expire_sec`.
        """
        max_age_ns = round(expire_s * SECOND_NS)
        fresh = [one for one in self._seen if abs(now_ns - one.t_ns) <= max_age_ns]
        self._seen = deque(fresh)
        return fresh


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
    import cv2  # noqa: PLC0415 an extra

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
