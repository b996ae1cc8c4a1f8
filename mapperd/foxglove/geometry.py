"""Poses, transforms and values as Foxglove messages."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from foxglove.messages import (
    FrameTransform,
    FrameTransforms,
    Odometry,
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    Timestamp,
    Vector3,
)
from numpy.typing import ArrayLike, NDArray

from mapperd.geometry.frames import quaternion_product, quaternion_to_matrix
from mapperd.wire.messages import LocalizationMessage, PoseMessage

__all__ = [
    "IDENTITY",
    "Frames",
    "cloud",
    "odometry",
    "particle_poses",
    "planar_fix",
    "planar_pose",
    "points",
    "pose",
    "pose_in_frame",
    "quaternion",
    "stamp",
    "transforms",
    "vector",
]

NS = 1_000_000_000

IDENTITY = (0.0, 0.0, 0.0, 1.0)

_TYPES = {
    "u1": PackedElementFieldNumericType.Uint8,
    "u4": PackedElementFieldNumericType.Uint32,
    "f4": PackedElementFieldNumericType.Float32,
}


def stamp(stamp_ns: int) -> Timestamp:
    """Unix nanoseconds as seconds and nanoseconds."""
    return Timestamp(sec=stamp_ns // NS, nsec=stamp_ns % NS)


def vector(xyz: Iterable[float]) -> Vector3:
    """Vector message."""
    x, y, z = map(float, xyz)
    return Vector3(x=x, y=y, z=z)


def quaternion(xyzw: Iterable[float]) -> Quaternion:
    """Quaternion message; the real part comes last."""
    x, y, z, w = map(float, xyzw)
    return Quaternion(x=x, y=y, z=z, w=w)


def pose(position: Iterable[float], xyzw: Iterable[float] = IDENTITY) -> Pose:
    """Pose message."""
    return Pose(position=vector(position), orientation=quaternion(xyzw))


def planar_pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Pose:
    """Pose message without roll and pitch."""
    return pose((x_m, y_m, z_m), (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))


def points(xyz: ArrayLike) -> list[Point3]:
    """Point messages of (N, 3) coordinates."""
    rows: list[list[float]] = np.asarray(xyz, np.float64).reshape(-1, 3).tolist()
    return [Point3(x=x, y=y, z=z) for x, y, z in rows]


def cloud(
    rows: NDArray[np.void], frame: str, stamp_ns: int, origin: Pose | None = None
) -> PointCloud:
    """A point cloud of the rows of a packed structured array.

    Args:
        rows: little endian, of uint8, uint32 and float32.
        frame: frame of `origin`.
        stamp_ns: Unix time.
        origin: pose of the points' axes; None is the frame itself.
    """
    kind = rows.dtype
    fields = [
        PackedElementField(name=name, offset=offset, type=_TYPES[field.str[1:]])
        for name, (field, offset, *_) in (kind.fields or {}).items()
    ]
    return PointCloud(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        pose=origin or pose((0.0, 0.0, 0.0)),
        point_stride=kind.itemsize,
        fields=fields,
        data=rows.tobytes(),
    )


class Frames:
    """Names of the frames.

    Args:
        map_frame: frame of the served map.
        settings: the daemon's settings by name, as far as known.
    """

    def __init__(self, map_frame: str, settings: Mapping[str, Any]) -> None:
        self.map = map_frame
        self.base = _frame_name(settings, "frames.base", "base_link")
        self.sonar = _frame_name(settings, "frames.sonar", "sonar_link")


def transforms(vehicle: PoseMessage, frames: Frames) -> FrameTransforms:
    """Transforms from map to base and from base to sonar."""
    map_q_base = _wxyz(vehicle.orientation_xyzw)
    base_q_map = map_q_base * (1, -1, -1, -1)
    base_to_sonar_m = np.subtract(vehicle.sonar_position_m, vehicle.position_m)
    mounting = quaternion_product(base_q_map, _wxyz(vehicle.sonar_orientation_xyzw))
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(vehicle.stamp_ns),
                parent_frame_id=frames.map,
                child_frame_id=frames.base,
                translation=vector(vehicle.position_m),
                rotation=quaternion(vehicle.orientation_xyzw),
            ),
            FrameTransform(
                timestamp=stamp(vehicle.stamp_ns),
                parent_frame_id=frames.base,
                child_frame_id=frames.sonar,
                translation=vector(quaternion_to_matrix(base_q_map) @ base_to_sonar_m),
                rotation=quaternion(np.roll(mounting, -1)),
            ),
        ]
    )


def pose_in_frame(vehicle: PoseMessage, frames: Frames) -> PoseInFrame:
    """Pose of the base in the map frame."""
    return PoseInFrame(
        timestamp=stamp(vehicle.stamp_ns),
        frame_id=frames.map,
        pose=pose(vehicle.position_m, vehicle.orientation_xyzw),
    )


def odometry(vehicle: PoseMessage, frames: Frames) -> Odometry:
    """Odometry of the base: pose in the map frame, velocity in the base frame if known."""
    velocity = None
    if vehicle.velocity_mps is not None:
        map_from_base = quaternion_to_matrix(_wxyz(vehicle.orientation_xyzw))
        velocity = vector(map_from_base.T @ np.asarray(vehicle.velocity_mps))
    return Odometry(
        timestamp=stamp(vehicle.stamp_ns),
        frame_id=frames.map,
        body_frame_id=frames.base,
        pose=pose(vehicle.position_m, vehicle.orientation_xyzw),
        linear_velocity=velocity,
        pose_covariance=None if vehicle.covariance is None else list(vehicle.covariance),
    )


def particle_poses(
    state: LocalizationMessage, frame: str, z_m: float, stamp_ns: int
) -> PosesInFrame:
    """Particles of the planar filter, drawn at the vehicle's height."""
    rows: list[list[float]] = np.frombuffer(state.particles, "<f4").reshape(-1, 4).tolist()
    return PosesInFrame(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        poses=[planar_pose(x_m, y_m, z_m, yaw_rad) for x_m, y_m, yaw_rad, _ in rows],
    )


def planar_fix(fix: Mapping[str, Any], frame: str, z_m: float, stamp_ns: int) -> PoseInFrame:
    """Most likely pose: `x_m`, `y_m`, `yaw_rad`."""
    return PoseInFrame(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        pose=planar_pose(float(fix["x_m"]), float(fix["y_m"]), z_m, float(fix["yaw_rad"])),
    )


def _frame_name(settings: Mapping[str, Any], name: str, default: str) -> str:
    facts = settings.get(name)
    value = facts.get("value") if isinstance(facts, Mapping) else None
    return value if isinstance(value, str) else default


def _wxyz(xyzw: Sequence[float]) -> NDArray[np.float64]:
    return np.roll(np.asarray(xyzw, np.float64), 1)
