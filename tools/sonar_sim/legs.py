"""Legs of the sound's way: where it leaves and where it is heard, as the kernels want them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.poses import Pose

LEG = 16
"""Numbers of a leg: origin (3), rotation (9), drift (3), gain (1)."""


@dataclass(frozen=True, slots=True, eq=False)
class SonarMotion:
    """How the sonar moves while it listens.

    Attributes:
        linear_mps: velocity, map frame, (3,).
        angular_rps: turn rates, sonar frame, (3,).
    """

    linear_mps: NDArray[np.float64]
    angular_rps: NDArray[np.float64]

    def pose(self, start: Pose, time_s: float) -> Pose:
        """The sonar's pose a while after `start`."""
        turn = rotation_by(np.asarray(self.angular_rps) * time_s)
        moved = start.position_m + np.asarray(self.linear_mps) * time_s
        return Pose(moved, start.rotation @ turn)


def rotation_by(vector_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation about a vector by its length (Rodrigues), (3, 3)."""
    x, y, z = vector_rad
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(vector_rad))
    sine = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rotation: NDArray[np.float64] = np.eye(3) + sine * skew + versine * skew @ skew
    return rotation


def leg_in(
    map_T_object: Pose,  # noqa: N803
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    drift_m: NDArray[np.float64] | None = None,
    gain: float = 1.0,
) -> NDArray[np.float64]:
    """A leg of the map in an object's frame, (16,).

    Args:
        map_T_object: the object.
        origin_m: of the leg, map frame, (3,).
        rotation: map from sonar; may mirror, (3, 3).
        drift_m: growth of the apparent range per unit of direction, map frame, (3,).
        gain: of pressure.
    """
    back = map_T_object.rotation.T
    drift = np.zeros(3) if drift_m is None else back @ drift_m
    origin = back @ (origin_m - map_T_object.position_m)
    return np.concatenate([origin, (back @ rotation).ravel(), drift, [gain]])
