"""Poses, transforms and values as those of Foxglove's messages."""

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
from mapperd.wire.messages import Localization
from mapperd.wire.messages import Pose as VehiclePose

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
    """Three numbers."""
    x, y, z = map(float, xyz)
    return Vector3(x=x, y=y, z=z)


def quaternion(xyzw: Iterable[float]) -> Quaternion:
    """Four numbers, the real one last."""
    x, y, z, w = map(float, xyzw)
    return Quaternion(x=x, y=y, z=z, w=w)


def pose(position: Iterable[float], xyzw: Iterable[float] = IDENTITY) -> Pose:
    """A position and an orientation."""
    return Pose(position=vector(position), orientation=quaternion(xyzw))


def planar_pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Pose:
    """A pose that stands upright."""
    return pose((x_m, y_m, z_m), (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))


def points(xyz: ArrayLike) -> list[Point3]:
    """Points (N, 3)."""
    rows: list[list[float]] = np.asarray(xyz, np.float64).reshape(-1, 3).tolist()
    return [Point3(x=x, y=y, z=z) for x, y, z in rows]


def cloud(
    rows: NDArray[np.void], frame: str, stamp_ns: int, origin: Pose | None = None
) -> PointCloud:
    """A point cloud of the rows of a packed structured array.

    Args:
        rows: little endian, of uint8, uint32 and float32.
        frame: that `origin` is in.
        stamp_ns: Unix.
        origin: of the points; None is the frame's.
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
        map_frame: of the map that is served.
        settings: facts of the daemon's settings by name, as far as they are known.
    """

    def __init__(self, map_frame: str, settings: Mapping[str, Any]) -> None:
        self.map = map_frame
        self.base = _named(settings, "frames.base", "base_link")
        self.sonar = _named(settings, "frames.sonar", "sonar_link")


def transforms(said: VehiclePose, frames: Frames) -> FrameTransforms:
    """Map to base, and base to sonar."""
    map_q_base = _wxyz(said.orientation_xyzw)
    base_q_map = map_q_base * (1, -1, -1, -1)
    base_to_sonar_m = np.subtract(said.sonar_position_m, said.position_m)
    mounting = quaternion_product(base_q_map, _wxyz(said.sonar_orientation_xyzw))
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(said.stamp_ns),
                parent_frame_id=frames.map,
                child_frame_id=frames.base,
                translation=vector(said.position_m),
                rotation=quaternion(said.orientation_xyzw),
            ),
            FrameTransform(
                timestamp=stamp(said.stamp_ns),
                parent_frame_id=frames.base,
                child_frame_id=frames.sonar,
                translation=vector(quaternion_to_matrix(base_q_map) @ base_to_sonar_m),
                rotation=quaternion(np.roll(mounting, -1)),
            ),
        ]
    )


def pose_in_frame(said: VehiclePose, frames: Frames) -> PoseInFrame:
    """Of the base."""
    return PoseInFrame(
        timestamp=stamp(said.stamp_ns),
        frame_id=frames.map,
        pose=pose(said.position_m, said.orientation_xyzw),
    )


def odometry(said: VehiclePose, frames: Frames) -> Odometry:
    """Of the base, with its velocity in its own axes; what is unknown is left out."""
    velocity = None
    if said.velocity_mps is not None:
        map_from_base = quaternion_to_matrix(_wxyz(said.orientation_xyzw))
        velocity = vector(map_from_base.T @ np.asarray(said.velocity_mps))
    return Odometry(
        timestamp=stamp(said.stamp_ns),
        frame_id=frames.map,
        body_frame_id=frames.base,
        pose=pose(said.position_m, said.orientation_xyzw),
        linear_velocity=velocity,
        pose_covariance=None if said.covariance is None else list(said.covariance),
    )


def particle_poses(said: Localization, frame: str, z_m: float, stamp_ns: int) -> PosesInFrame:
    """The cloud of a filter in the plane, drawn at the vehicle's height."""
    rows: list[list[float]] = np.frombuffer(said.particles, "<f4").reshape(-1, 4).tolist()
    return PosesInFrame(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        poses=[planar_pose(x_m, y_m, z_m, yaw_rad) for x_m, y_m, yaw_rad, _ in rows],
    )


def planar_fix(fix: Mapping[str, Any], frame: str, z_m: float, stamp_ns: int) -> PoseInFrame:
    """Where the vehicle most likely is: `x_m`, `y_m`, `yaw_rad`."""
    return PoseInFrame(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        pose=planar_pose(float(fix["x_m"]), float(fix["y_m"]), z_m, float(fix["yaw_rad"])),
    )


def _named(settings: Mapping[str, Any], name: str, otherwise: str) -> str:
    facts = settings.get(name)
    value = facts.get("value") if isinstance(facts, Mapping) else None
    return value if isinstance(value, str) else otherwise


def _wxyz(xyzw: Sequence[float]) -> NDArray[np.float64]:
    return np.roll(np.asarray(xyzw, np.float64), 1)
