"""A robot as a sonar sees it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Point", "Robot"]

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
        """Where it is in the map, if in the middle of the vertical aperture: no image tells."""
        x_m = self.range_m * math.cos(self.bearing_rad)
        y_m = -self.range_m * math.sin(self.bearing_rad)
        x, y, z = (map_T_sonar @ (x_m, y_m, 0.0, 1.0))[:3]
        return float(x), float(y), float(z)
