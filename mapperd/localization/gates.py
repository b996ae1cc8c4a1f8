"""When a scan leads to an update of the filter."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["MotionGate", "evenly_spaced"]

Floats = NDArray[np.float64]


@dataclass(slots=True)
class MotionGate:
    """True on the first call, and after motion beyond a threshold since it was last true.

    Attributes:
        min_distance_m: translation, strictly more.
        min_angle_rad: rotation, strictly more.
    """

    min_distance_m: float
    min_angle_rad: float
    _last: Floats | None = None

    def passes(self, odometry_pose: Floats) -> bool:
        """Whether the (3,) pose in the odometry frame is far enough from the last that passed."""
        if self._last is not None:
            dx, dy = odometry_pose[:2] - self._last[:2]
            turn = math.remainder(odometry_pose[2] - self._last[2], 2 * math.pi)
            far = math.hypot(dx, dy) > self.min_distance_m
            if not far and not abs(turn) > self.min_angle_rad:
                return False
        self._last = odometry_pose.copy()
        return True

    def reset(self) -> None:
        """Let the next pose pass."""
        self._last = None


def evenly_spaced(count: int, wanted: int) -> NDArray[np.intp]:
    """Indices of `wanted` of `count` things: ceil(k (count - 1) / (wanted - 1)).

    All where more are wanted than there are, the first for one, none for none.
    """
    if wanted <= 1 or count == 0:
        return np.arange(min(count, max(wanted, 0)))
    if wanted >= count:
        return np.arange(count)
    k = np.arange(wanted)
    return -(-k * (count - 1) // (wanted - 1))
