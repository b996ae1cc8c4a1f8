"""How the sonar moves while its ping is in the water."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.geometry.frames import Pose

__all__ = ["BaseMotion", "PingMotion"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PingMotion:
    """Velocity and rate, constant over one ping.

    Attributes:
        linear_mps: (3,) float64, velocity of the sonar, map frame.
        angular_radps: (3,) float64, rate of turn, sonar frame.
        valid_s: seconds after transmission at which the ping's `map_T_sonar` holds.
        speed_of_sound_mps: turns ranges into times.
    """

    linear_mps: Floats
    angular_radps: Floats
    valid_s: float
    speed_of_sound_mps: float


@dataclass(frozen=True, slots=True, eq=False)
class BaseMotion:
    """The vehicle's motion at the time of its pose; what is unknown is taken as at rest.

    Attributes:
        velocity_map_mps: (3,) of the base's origin, map frame, or None: unknown.
        rate_radps: (3,) of the base, base frame, or None.
    """

    velocity_map_mps: ArrayLike | None = None
    rate_radps: ArrayLike | None = None

    def of_sonar(
        self,
        pose: Pose,
        base_T_sonar: Floats,  # noqa: N803 frames are named
        valid_s: float,
        speed_of_sound_mps: float,
    ) -> PingMotion:
        """The sonar's motion: a turning base swings it on its lever arm.

        Args:
            pose: of the base, at the same time as the motion.
            base_T_sonar: (4, 4) rigid transform of the mounting.
            valid_s: when that is, seconds after transmission.
            speed_of_sound_mps: in the water.
        """
        velocity, rate = _vector(self.velocity_map_mps), _vector(self.rate_radps)
        swing_base_mps = _cross(rate, base_T_sonar[:3, 3])
        return PingMotion(
            linear_mps=velocity + pose.map_T_base[:3, :3] @ swing_base_mps,
            angular_radps=base_T_sonar[:3, :3].T @ rate,
            valid_s=valid_s,
            speed_of_sound_mps=speed_of_sound_mps,
        )


def _vector(values: ArrayLike | None) -> Floats:
    return np.zeros(3) if values is None else np.asarray(values, dtype=np.float64)


def _cross(a: Floats, b: Floats) -> Floats:
    """As `np.cross`, which takes ten times as long on two vectors."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
