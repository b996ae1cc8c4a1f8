"""Robots that a sonar sees, and a memory of the recent ones."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_SIGHTINGS", "Point", "Robot", "Sighting", "Sightings"]

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
