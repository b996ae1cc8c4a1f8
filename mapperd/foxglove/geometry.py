"""Poses, transforms, clouds and scene entities as Foxglove messages."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from foxglove.messages import (
    Color,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Odometry,
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from numpy.typing import ArrayLike, NDArray

from mapperd.geometry.frames import quaternion_product, quaternion_to_matrix
from mapperd.wire.messages import FanMessage, LocalizationMessage, PoseMessage, RobotsMessage

__all__ = [
    "IDENTITY",
    "Frames",
    "PathDrawing",
    "cloud",
    "covariance_scene",
    "fan_scene",
    "odometry",
    "particle_poses",
    "planar_fix",
    "planar_pose",
    "points",
    "pose",
    "pose_in_frame",
    "quaternion",
    "robots_scene",
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


ARC_POINTS = 33
ELLIPSE_POINTS = 48
SIGMAS = 2.0
ROBOT_M = 0.5

FAN = Color(r=0.2, g=0.8, b=1.0, a=0.9)
PATH = Color(r=1.0, g=0.8, b=0.1, a=1.0)
ROBOT = Color(r=1.0, g=0.3, b=0.3, a=0.8)
COVARIANCE = Color(r=0.9, g=0.3, b=1.0, a=0.9)
WHITE = Color(r=1.0, g=1.0, b=1.0, a=1.0)


def fan_scene(fan: FanMessage, frame: str, stamp_ns: int) -> SceneUpdate:
    """Outline of the sonar's field of view; moves with the sonar's frame."""
    half = fan.vertical_aperture_rad / 2
    faces = [_face(fan, elevation) for elevation in (-half, half)]
    corners = (0, ARC_POINTS - 1, ARC_POINTS, 2 * ARC_POINTS - 1)
    edges = np.stack([faces[0][list(corners)], faces[1][list(corners)]], axis=1)
    lines = [_line(face, FAN, LinePrimitiveLineType.LineLoop) for face in faces]
    lines.append(_line(edges.reshape(-1, 3), FAN, LinePrimitiveLineType.LineList))
    return SceneUpdate(entities=[_entity("fan", frame, stamp_ns, lines=lines, frame_locked=True)])


def robots_scene(robots: RobotsMessage, frame: str, stamp_ns: int) -> SceneUpdate:
    """A sphere for each robot, labelled with the age of its sighting; replaces earlier ones."""
    entities = [
        _entity(
            f"robot {number}",
            frame,
            stamp_ns,
            spheres=[
                SpherePrimitive(pose=pose((x, y, z)), size=vector((ROBOT_M,) * 3), color=ROBOT)
            ],
            texts=[
                TextPrimitive(
                    pose=pose((x, y, z + ROBOT_M)),
                    billboard=True,
                    font_size=14.0,
                    scale_invariant=True,
                    color=WHITE,
                    text=f"robot, {max(stamp_ns - seen_ns, 0) / NS:.0f} s ago",
                )
            ],
        )
        for number, (seen_ns, x, y, z) in enumerate(robots.seen)
    ]
    return SceneUpdate(deletions=[_all()], entities=entities)


def covariance_scene(
    fix: Mapping[str, Any] | None, frame: str, z_m: float, stamp_ns: int
) -> SceneUpdate:
    """Ellipse of two standard deviations around a planar fix; empty without a fix."""
    if fix is None:
        return SceneUpdate(deletions=[_all()])
    covariance = np.asarray(fix["covariance"], np.float64)[:2, :2]
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    turn = np.linspace(0, 2 * math.pi, ELLIPSE_POINTS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)]) * np.sqrt(np.maximum(values, 0))[:, None]
    outline = np.zeros((ELLIPSE_POINTS, 3))
    outline[:, :2] = (fix["x_m"], fix["y_m"]) + SIGMAS * (axes @ circle).T
    outline[:, 2] = z_m
    line = _line(outline, COVARIANCE, LinePrimitiveLineType.LineLoop)
    return SceneUpdate(entities=[_entity("covariance", frame, stamp_ns, lines=[line])])


class PathDrawing:
    """The vehicle's path in pieces, so that only changed pieces are published."""

    PIECE = 1000
    """Points of a piece; each piece begins at the last point of the one before."""

    def __init__(self) -> None:
        self._sent = np.zeros((0, 3), np.float64)

    def clear(self) -> None:
        """Forget the pieces that were published."""
        self._sent = np.zeros((0, 3), np.float64)

    def update(self, path: NDArray[np.float64], frame: str, stamp_ns: int) -> SceneUpdate | None:
        """Return the changed pieces, or None without a change.

        Args:
            path: (N, 3), the whole path.
            frame: frame of the points.
            stamp_ns: time of the newest point.
        """
        first = _same(self._sent, path)
        if first == len(self._sent) == len(path):
            return None
        pieces, before = (range(_pieces(len(track))) for track in (path, self._sent))
        entities = [
            self._piece(path, piece, frame, stamp_ns)
            for piece in pieces
            if (piece + 1) * self.PIECE >= first
        ]
        deletions = [
            SceneEntityDeletion(type=SceneEntityDeletionType.MatchingId, id=f"path {piece}")
            for piece in before[len(pieces) :]
        ]
        self._sent = path.copy()
        return SceneUpdate(deletions=deletions, entities=entities)

    def _piece(
        self, path: NDArray[np.float64], piece: int, frame: str, stamp_ns: int
    ) -> SceneEntity:
        begin = piece * self.PIECE
        line = _line(path[begin : begin + self.PIECE + 1], PATH, LinePrimitiveLineType.LineStrip)
        return _entity(f"path {piece}", frame, stamp_ns, lines=[line])


def _pieces(length: int) -> int:
    """Number of pieces; a single point draws nothing."""
    return -(-max(length - 1, 0) // PathDrawing.PIECE)


def _same(one: NDArray[np.float64], other: NDArray[np.float64]) -> int:
    """Length of the common prefix."""
    length = min(len(one), len(other))
    differ = (one[:length] != other[:length]).any(axis=1)
    return int(differ.argmax()) if differ.any() else length


def _face(fan: FanMessage, elevation_rad: float) -> NDArray[np.float64]:
    """(2 ARC_POINTS, 3) sonar frame: along the near arc to starboard, back along the far one."""
    bearing = np.linspace(*fan.bearings_rad, ARC_POINTS)
    arc = np.stack(
        [
            np.cos(elevation_rad) * np.cos(bearing),
            -np.cos(elevation_rad) * np.sin(bearing),
            np.full(ARC_POINTS, math.sin(elevation_rad)),
        ],
        axis=1,
    )
    return np.concatenate([fan.min_range_m * arc, fan.max_range_m * arc[::-1]])


def _line(xyz: ArrayLike, color: Color, kind: LinePrimitiveLineType) -> LinePrimitive:
    return LinePrimitive(
        type=kind,
        pose=pose((0.0, 0.0, 0.0)),
        thickness=2.0,
        scale_invariant=True,
        points=points(xyz),
        color=color,
    )


def _entity(
    name: str,
    frame: str,
    stamp_ns: int,
    *,
    lines: Sequence[LinePrimitive] = (),
    spheres: Sequence[SpherePrimitive] = (),
    texts: Sequence[TextPrimitive] = (),
    frame_locked: bool = False,
) -> SceneEntity:
    return SceneEntity(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        id=name,
        frame_locked=frame_locked,
        lines=list(lines),
        spheres=list(spheres),
        texts=list(texts),
    )


def _all() -> SceneEntityDeletion:
    return SceneEntityDeletion(type=SceneEntityDeletionType.All)
