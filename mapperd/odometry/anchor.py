"""Where an odometry's world lies in the map: moved when the estimate jumps, not the vehicle."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import quaternion_product

__all__ = ["Anchor", "yaw_between"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A turn about the vertical and a shift, from the source's world to the map.

    Attributes:
        yaw_rad: of the source's world in the map.
        shift_m: (3,), its origin in the map.
    """

    yaw_rad: float
    shift_m: Floats

    @classmethod
    def none(cls) -> "Anchor":
        """The source's world is the map."""
        return cls(0.0, np.zeros(3))

    @classmethod
    def joining(cls, source_m: Floats, map_m: Floats, yaw_rad: float) -> "Anchor":
        """The one that turns by an angle and takes one place to another."""
        turn_only = cls(yaw_rad, np.zeros(3))
        return cls(yaw_rad, map_m - turn_only.place(source_m))

    def place(self, source_m: Floats) -> Floats:
        """A position (3,) in the map."""
        return self.direction(source_m) + self.shift_m

    def direction(self, source: Floats) -> Floats:
        """A vector (3,) in map axes."""
        if self.yaw_rad == 0.0:
            return source
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y, z = source
        return np.array([c * x - s * y, s * x + c * y, z])

    def attitude(self, source_q_base: Floats) -> Floats:
        """An orientation (4,) in the map."""
        if self.yaw_rad == 0.0:
            return source_q_base
        half = self.yaw_rad / 2.0
        return quaternion_product((math.cos(half), 0.0, 0.0, math.sin(half)), source_q_base)


def yaw_between(source_q_base: Floats, map_q_base: Floats) -> float:
    """Turn about the vertical that takes one attitude nearest to another, rad.

    The twist about z of map_q_base · source_q_base⁻¹.
    """
    conjugate = source_q_base * np.array([1.0, -1.0, -1.0, -1.0])
    w, _, _, z = quaternion_product(map_q_base, conjugate)
    return 2.0 * math.atan2(z, w)
