"""Rigid poses and the sonar's mounting; quaternions are (w, x, y, z), scalar first."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.errors import SonarSimError


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """Where a frame stands in its parent.

    Attributes:
        position_m: origin, (3,).
        rotation: parent from child, (3, 3).
    """

    position_m: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def __matmul__(self, child: "FramePose") -> "FramePose":
        """Chain: the child's pose, given in this frame, in this frame's parent."""
        return FramePose(
            self.position_m + self.rotation @ child.position_m, self.rotation @ child.rotation
        )

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """Unit quaternion (w, x, y, z) with w >= 0."""
        return quaternion_of(self.rotation)


def require_finite(pose: FramePose, *numbers: float | NDArray[np.float64]) -> None:
    """Check a pose, and what comes with it.

    Raises:
        SonarSimError: a number is NaN or infinite.
    """
    if not (np.isfinite(pose.position_m).all() and np.isfinite(pose.rotation).all()):
        raise SonarSimError(f"a pose at {np.asarray(pose.position_m).tolist()} is not finite")
    for one in numbers:
        if not np.isfinite(one).all():
            raise SonarSimError(f"a time, velocity or turn rate is not finite: {one}")


@dataclass(frozen=True, slots=True)
class Mounting:
    """The sonar on its vehicle: Rz(yaw) Ry(pitch) Rx(roll); pitch 90° looks straight down."""

    position_m: tuple[float, float, float] = (0.0, 0.0, -0.5)
    roll_deg: float = 0.0
    pitch_deg: float = 90.0
    yaw_deg: float = 0.0

    @property
    def pose(self) -> FramePose:
        """The sonar frame in the base frame."""
        rotation = rotation_of(
            math.radians(self.roll_deg), math.radians(self.pitch_deg), math.radians(self.yaw_deg)
        )
        return FramePose(np.asarray(self.position_m, dtype=np.float64), rotation)


def rotation_of(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """Rz(yaw) Ry(pitch) Rx(roll), (3, 3); positive pitch turns the nose (+x) down."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix.

    Solved from the largest of the four squares (Shepperd 1978), so that nothing small divides.
    """
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    products = np.array(
        [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]],
        ]
    )
    row = products[int(np.argmax(squares))]
    unit: NDArray[np.float64] = row / np.linalg.norm(row)
    return -unit if unit[0] < 0.0 else unit


def rotation_of_quaternion(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix of a quaternion (w, x, y, z) of any length but 0, (3, 3).

    Raises:
        ValueError: its length is 0 or not finite.
    """
    length = float(np.linalg.norm(quaternion))
    if not 0.0 < length < math.inf:
        raise ValueError(f"quaternion {quaternion.tolist()} is no rotation")
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class SonarMotion:
    """How the sonar moves while it listens.

    Attributes:
        linear_mps: velocity, map frame, (3,).
        angular_rps: turn rates, sonar frame, (3,).
    """

    linear_mps: NDArray[np.float64]
    angular_rps: NDArray[np.float64]

    def pose(self, start: FramePose, time_s: float) -> FramePose:
        """The sonar's pose a while after `start`."""
        turn = rotation_by(np.asarray(self.angular_rps) * time_s)
        moved = start.position_m + np.asarray(self.linear_mps) * time_s
        return FramePose(moved, start.rotation @ turn)


def rotation_by(vector_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation about a vector by its length (Rodrigues), (3, 3)."""
    x, y, z = vector_rad
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(vector_rad))
    sine = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rotation: NDArray[np.float64] = np.eye(3) + sine * skew + versine * skew @ skew
    return rotation


def rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axis times angle of a rotation, 0 to pi, (3,): the inverse of `rotation_by`."""
    w, *xyz = quaternion_of(rotation)
    axis = np.asarray(xyz)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:  # noqa: PLR2004 no axis
        return 2.0 * axis
    vector: NDArray[np.float64] = axis * (2.0 * math.atan2(sine, float(w)) / sine)
    return vector
