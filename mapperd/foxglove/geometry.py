"""Values of ours as those of Foxglove's messages."""

import math
from collections.abc import Iterable

import numpy as np
from foxglove.messages import (
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    Quaternion,
    Timestamp,
    Vector3,
)
from numpy.typing import ArrayLike, NDArray

__all__ = ["IDENTITY", "cloud", "planar_pose", "points", "pose", "quaternion", "stamp", "vector"]

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
