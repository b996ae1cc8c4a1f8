"""Frames: the only place where conventions are converted.

Inside, the map is x east, y north, z up (ENU), the base x forward, y port, z up (FLU), and the
sonar likewise at zero mounting angles. Quaternions are (w, x, y, z) of unit length; map_q_base
takes base coordinates to map coordinates. NED and FRD exist only at the edges.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "BODY_TO_FLU",
    "WORLD_TO_ENU",
    "Body",
    "Pose",
    "World",
    "angles_of",
    "compass_quaternion",
    "compass_to_map",
    "orientation_from_map",
    "orientation_to_map",
    "pose_from_rpy",
    "quaternion_between",
    "quaternion_product",
    "quaternion_to_matrix",
    "rigid_transform",
    "rotation_from_rpy",
]

World = Literal["enu", "ned", "local_flu", "local_frd"]
"""Axes of a fixed frame; the local ones point along and across an arbitrary heading."""

Body = Literal["flu", "frd"]
Floats = NDArray[np.float64]

NEARLY_PARALLEL = 0.9995
"""Above this dot product (1.8 degrees apart) the chord is as good as the arc, and never 0/0."""

UNIT_TOLERANCE = 1e-6


def _constant(rows: ArrayLike) -> Floats:
    matrix = np.array(rows, dtype=np.float64)
    matrix.setflags(write=False)
    return matrix


WORLD_TO_ENU: dict[World, Floats] = {
    "enu": _constant([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "ned": _constant([[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "local_flu": _constant([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "local_frd": _constant([[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
}
"""Rotation from a sender's world axes to the map's; each is its own inverse.

Of a local world, x becomes the map's x: such a map is turned, but level.
"""

BODY_TO_FLU: dict[Body, Floats] = {
    "flu": _constant([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "frd": _constant([[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
}
"""Rotation from a sender's body axes to the base's; each is its own inverse."""

_HALF = math.sqrt(0.5)
_ENU_Q_WORLD: dict[World, tuple[float, ...]] = {
    "enu": (1, 0, 0, 0),
    "ned": (0, _HALF, _HALF, 0),
    "local_flu": (1, 0, 0, 0),
    "local_frd": (0, 1, 0, 0),
}
_BODY_Q_FLU: dict[Body, tuple[float, ...]] = {"flu": (1, 0, 0, 0), "frd": (0, 1, 0, 0)}


def quaternion_product(left: ArrayLike, right: ArrayLike) -> Floats:
    """Hamilton product of (w, x, y, z) quaternions: first `right` turns, then `left`."""
    # Python's floats: on single numbers numpy's take several times as long.
    w1, x1, y1, z1 = np.asarray(left, dtype=np.float64).tolist()
    w2, x2, y2, z2 = np.asarray(right, dtype=np.float64).tolist()
    return np.array(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ]
    )


def quaternion_to_matrix(quaternion: ArrayLike) -> Floats:
    """Rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_between(start: ArrayLike, end: ArrayLike, fraction: float) -> Floats:
    """Turn from `start` (fraction 0) to `end` (1) by the shorter way, at constant rate.

    Args:
        start: unit quaternion (w, x, y, z).
        end: unit quaternion; its sign does not matter.
        fraction: may lie outside 0..1, the turn then goes on at the same rate.

    Returns:
        Unit quaternion (4,).
    """
    first = np.asarray(start, dtype=np.float64)
    last = np.asarray(end, dtype=np.float64)
    dot = float(first @ last)
    if dot < 0:  # q and -q are the same orientation: take the near one
        last, dot = -last, -dot
    if dot > NEARLY_PARALLEL:
        mixed = first + fraction * (last - first)
    else:
        angle = math.acos(dot)
        mixed = math.sin((1 - fraction) * angle) * first + math.sin(fraction * angle) * last
    return np.asarray(mixed / np.linalg.norm(mixed), dtype=np.float64)


def rotation_from_rpy(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Floats:
    """Rz(yaw) Ry(pitch) Rx(roll) as a quaternion (w, x, y, z); angles in degrees.

    Positive yaw turns to port, positive pitch turns the nose down.
    """
    roll, pitch, yaw = (math.radians(angle) / 2 for angle in (roll_deg, pitch_deg, yaw_deg))
    about_z = (math.cos(yaw), 0.0, 0.0, math.sin(yaw))
    about_y = (math.cos(pitch), 0.0, math.sin(pitch), 0.0)
    about_x = (math.cos(roll), math.sin(roll), 0.0, 0.0)
    return quaternion_product(about_z, quaternion_product(about_y, about_x))


def orientation_to_map(quaternion: ArrayLike, world: World, body: Body) -> Floats:
    """A sender's world_q_body as our map_q_base: q_enu_world, then its own, then q_body_flu."""
    turned = quaternion_product(_ENU_Q_WORLD[world], np.asarray(quaternion, dtype=np.float64))
    return quaternion_product(turned, _BODY_Q_FLU[body])


def orientation_from_map(map_q_base: ArrayLike, world: World, body: Body) -> Floats:
    """Our map_q_base as a receiver's world_q_body; the same turns, which are their own inverse."""
    return orientation_to_map(map_q_base, world, body)


def angles_of(quaternion: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians of a unit quaternion (w, x, y, z): Rz(yaw) Ry(pitch) Rx(roll).

    Roll and yaw in -pi to pi, pitch in -pi/2 to pi/2.
    """
    w, x, y, z = np.asarray(quaternion, dtype=np.float64).tolist()
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - x * z), -1.0), 1.0))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def compass_quaternion(roll_deg: float, pitch_deg: float, heading_deg: float) -> Floats:
    """map_q_base of a vehicle's own angles: starboard down, nose up, clockwise from north."""
    ned_q_frd = rotation_from_rpy(roll_deg, pitch_deg, heading_deg)
    return orientation_to_map(ned_q_frd, "ned", "frd")


def compass_to_map(heading_deg: float) -> float:
    """A compass heading, or a course, as an angle in the map: radians from east, -pi to pi."""
    return math.remainder(math.radians(90.0 - heading_deg), math.tau)


def rigid_transform(position_m: ArrayLike, quaternion: ArrayLike) -> Floats:
    """Homogeneous matrix (4, 4) of a position (3,) and a unit quaternion (w, x, y, z)."""
    matrix = np.eye(4)
    matrix[:3, :3] = quaternion_to_matrix(quaternion)
    matrix[:3, 3] = position_m
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the vehicle is: base frame in the map frame.

    Attributes:
        position_m: (3,) float64, read-only, map frame.
        map_q_base: (4,) float64, read-only, unit quaternion (w, x, y, z).
    """

    position_m: Floats
    map_q_base: Floats

    def __post_init__(self) -> None:
        """Own the arrays, so that nobody can change them afterwards.

        Raises:
            ValueError: wrong shape, not finite, or not a unit quaternion.
        """
        position, quaternion = _constant(self.position_m), _constant(self.map_q_base)
        if position.shape != (3,) or quaternion.shape != (4,):
            raise ValueError("a pose is a position of 3 and a quaternion of 4 numbers")
        if not (
            all(map(math.isfinite, position.tolist()))
            and abs(float(quaternion @ quaternion) - 1) < UNIT_TOLERANCE
        ):
            raise ValueError("a pose is a finite position and a unit quaternion")
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "map_q_base", quaternion)

    @property
    def map_T_base(self) -> Floats:  # noqa: N802 frames are named
        """(4, 4) rigid transform: takes base coordinates to map coordinates."""
        return rigid_transform(self.position_m, self.map_q_base)


def pose_from_rpy(position_m: ArrayLike, rpy_deg: tuple[float, float, float]) -> Pose:
    """Pose from a position (3,) in metres and (roll, pitch, yaw) in degrees."""
    return Pose(np.asarray(position_m, dtype=np.float64), rotation_from_rpy(*rpy_deg))
