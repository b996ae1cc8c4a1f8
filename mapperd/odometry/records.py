"""What an odometry source says, in our conventions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Clock", "Odometry"]

Clock = Literal["unix", "boot", "arrival"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One record; map frame ENU, base frame FLU, SI units. None is unknown, which is not zero.

    Attributes:
        stamp_ns: the sender's time, on the clock that `clock` names; 0 for "arrival".
        clock: "unix", "boot" (some zero of the sender's), or "arrival" (has no clock).
        position_m: (3,) base in map.
        map_q_base: (4,) unit quaternion (w, x, y, z).
        velocity_mps: (3,) of the base, in base axes.
        rate_radps: (3,) of the base, about base axes.
        pose_covariance: (6, 6), x y z in map axes then rotations about map axes; m and rad.
        twist_covariance: (6, 6), as velocity and rate, in base axes.
        reset_count: changes when the source's estimate jumped.
        source: the sender's name.
    """

    stamp_ns: int
    clock: Clock
    position_m: Floats | None
    map_q_base: Floats | None
    velocity_mps: Floats | None
    rate_radps: Floats | None
    pose_covariance: Floats | None
    twist_covariance: Floats | None
    reset_count: int
    source: str

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in self.__slots__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
