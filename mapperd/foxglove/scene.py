"""Scene entities: field of view, path, robots, covariance ellipse of localization."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove.messages import (
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
)
from numpy.typing import ArrayLike, NDArray

from mapperd.foxglove.geometry import points, pose, stamp, vector
from mapperd.wire.messages import FanMessage, RobotsMessage

__all__ = ["PathDrawing", "covariance_scene", "fan_scene", "robots_scene"]

ARC_POINTS = 33
ELLIPSE_POINTS = 48
SIGMAS = 2.0
ROBOT_M = 0.5
NS = 1e9

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
