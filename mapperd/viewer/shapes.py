"""Procedural shapes, and scene nodes that change in place."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.wire.messages import FanMessage

__all__ = ["Nodes", "Part", "box_lines", "cube", "ellipse", "fan_lines", "strip", "vehicle_parts"]

Floats = NDArray[np.float32]
Faces = NDArray[np.uint32]

ARC_STEPS = 32
ELLIPSE_STEPS = 48


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of a model.

    Attributes:
        name: name of the part.
        vertices: (V, 3) metres, base frame.
        faces: (F, 3), counter-clockwise from outside.
        colour: red, green, blue.
    """

    name: str
    vertices: Floats
    faces: Faces
    colour: tuple[int, int, int]


def cube() -> tuple[Floats, Faces]:
    """A unit cube around the origin; sides share no vertices, so that they are shaded flat."""
    vertices: list[Floats] = []
    faces: list[int] = []
    for axis in range(3):
        for sign in (-1, 1):
            side = np.zeros((4, 3), np.float32)
            side[:, axis] = sign * 0.5
            side[:, (axis + 1) % 3] = (-0.5, 0.5, 0.5, -0.5)
            side[:, (axis + 2) % 3] = (-0.5, -0.5, 0.5, 0.5)
            first = 4 * len(vertices)
            turn = (0, 1, 2, 0, 2, 3) if sign > 0 else (0, 2, 1, 0, 3, 2)
            faces += [first + one for one in turn]
            vertices.append(side)
    return np.concatenate(vertices), np.array(faces, np.uint32).reshape(-1, 3)


def vehicle_parts(length_m: float) -> tuple[Part, ...]:
    """A vehicle with hull, nose, fin and thrusters; the nose points along x."""
    half = length_m / 2
    wide, high = 0.36 * length_m, 0.22 * length_m
    hull = _loft([(-half, 0.55), (-0.7 * half, 1.0), (0.45 * half, 1.0)], wide, high, tail=True)
    nose = _loft([(0.45 * half, 1.0), (0.75 * half, 0.72), (half, 0.0)], wide, high)
    fin = _box((-0.9 * half, -0.02 * length_m, 0.5 * high), (-0.35 * half, 0.02 * length_m, high))
    sides = [
        _box(
            (-0.75 * half, sign * wide * 0.62 - 0.05 * length_m, -0.05 * length_m),
            (-0.15 * half, sign * wide * 0.62 + 0.05 * length_m, 0.05 * length_m),
        )
        for sign in (-1, 1)
    ]
    return (
        Part("hull", *hull, (250, 204, 21)),
        Part("nose", *nose, (239, 68, 68)),
        Part("fin", *fin, (239, 68, 68)),
        Part("thruster_starboard", *sides[0], (55, 65, 81)),
        Part("thruster_port", *sides[1], (55, 65, 81)),
    )


def fan_lines(fan: FanMessage) -> Floats:
    """Outline of a sonar's field of view: line segments (N, 2, 3), metres, sonar frame."""
    low, high = sorted(fan.bearings_rad)
    up = fan.vertical_aperture_rad / 2
    bearings = np.linspace(low, high, ARC_STEPS)
    lines: list[NDArray[np.floating]] = []
    for elevation in (-up, up):
        far = _at(fan.max_range_m, bearings, elevation)
        near = _at(fan.min_range_m, bearings, elevation)
        lines += [strip(far), strip(near), np.stack([near[[0, -1]], far[[0, -1]]], axis=1)]
    for bearing in (low, high):
        lines.append(strip(_at(fan.max_range_m, bearing, np.linspace(-up, up, 8))))
        lines.append(strip(_at(fan.min_range_m, bearing, np.linspace(-up, up, 8))))
    return np.concatenate(lines).astype(np.float32)


def ellipse(covariance: ArrayLike, sigmas: float) -> Floats:
    """The ellipse of a covariance (2, 2) around the origin: line segments (N, 2, 3) at z = 0."""
    values, vectors = np.linalg.eigh(np.asarray(covariance, np.float64)[:2, :2])
    angle = np.linspace(0, 2 * np.pi, ELLIPSE_STEPS + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    plane = sigmas * (vectors * np.sqrt(np.maximum(values, 0))) @ circle
    return strip(np.stack([plane[0], plane[1], np.zeros_like(angle)], axis=1))


def strip(points: ArrayLike) -> Floats:
    """Points (N, 3) as the segments between them, (N - 1, 2, 3)."""
    line = np.asarray(points, np.float32)
    return np.stack([line[:-1], line[1:]], axis=1)


def _at(range_m: float, bearing: ArrayLike, elevation: ArrayLike) -> NDArray[np.float64]:
    """Points of the sonar's frame; a bearing is positive to starboard, and y is to port."""
    turn, tilt = np.broadcast_arrays(np.asarray(bearing, float), np.asarray(elevation, float))
    return range_m * np.stack(
        [np.cos(tilt) * np.cos(turn), -np.cos(tilt) * np.sin(turn), np.sin(tilt)], axis=-1
    )


def _loft(
    rings: list[tuple[float, float]],
    wide: float,
    high: float,
    *,
    tail: bool = False,
) -> tuple[Floats, Faces]:
    """A body along x through eight-sided rings (x, size), closed at its tail or open."""
    angle = np.arange(8) * np.pi / 4 + np.pi / 8
    ring = np.stack([np.cos(angle) * wide / 2, np.sin(angle) * high / 2], axis=1) / np.cos(
        np.pi / 8
    )
    vertices = np.concatenate(
        [np.column_stack([np.full(8, x), ring * size]) for x, size in rings]
    ).astype(np.float32)
    faces = []
    for one in range(len(rings) - 1):
        for side in range(8):
            a, b = 8 * one + side, 8 * one + (side + 1) % 8
            faces += [(a, b, b + 8), (a, b + 8, a + 8)]
    if tail:
        faces += [(0, side + 1, side) for side in range(1, 7)]
    return vertices, np.array(faces, np.uint32)


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Floats, Faces]:
    vertices, faces = cube()
    size = np.subtract(high, low)
    return (vertices * size + np.add(low, high) / 2).astype(np.float32), faces


STAY = 6
"""Calls of `look` after which a replaced node is removed: browsers have drawn the new one."""


def box_lines(size_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the edges (12, 2, 3) of a box from the origin to its opposite corner (3,)."""
    corners = np.stack(np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij"), axis=-1).reshape(-1, 3)
    ends = [
        (one, other)
        for one in range(8)
        for other in range(one)
        if (corners[one] != corners[other]).sum() == 1
    ]
    lines: NDArray[np.float32] = (corners[np.array(ends)] * size_m).astype(np.float32)
    return lines


class Nodes:
    """Scene nodes by name; use from one thread."""

    def __init__(self) -> None:
        self._nodes: dict[str, Any] = {}
        self._replaced: dict[str, Any] = {}
        self._leaving: dict[str, tuple[int, Any]] = {}
        self._looks = 0

    def __contains__(self, name: str) -> bool:
        """Whether a node exists and is not replaced."""
        return name in self._nodes

    @property
    def leaving(self) -> int:
        """Number of replaced nodes to be removed."""
        return len(self._replaced) + len(self._leaving)

    def put(self, name: str, make: Callable[..., Any], **properties: object) -> None:
        """Create or update a node.

        Args:
            name: name of the node; one name is for one kind of node.
            make: adds a new node to the scene.
            properties: values to set, in this order.
        """
        if name not in self._nodes:
            node = self._replaced.pop(name, None) or self._leaving.pop(name, (0, None))[1]
            if node is None:
                self._nodes[name] = make(name, **properties)
                return
            self._nodes[name] = node
        for key, value in properties.items():
            setattr(self._nodes[name], key, value)

    def remove(self, name: str) -> None:
        """Remove a node now, if it exists."""
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()

    def replace(self, name: str) -> None:
        """Remove a node once its replacement, which exists, is drawn."""
        node = self._nodes.pop(name, None)
        if node is not None:
            self._leaving[name] = (self._looks, node)

    def replace_all(self) -> None:
        """Remove all nodes once their replacements, which do not exist yet, are drawn."""
        self._replaced |= self._nodes
        self._nodes.clear()

    def look(self, *, complete: bool) -> None:
        """Remove nodes that were replaced long enough ago; call a few times a second.

        Args:
            complete: all replacements exist.
        """
        self._looks += 1
        if complete:
            self._leaving |= {name: (self._looks, one) for name, one in self._replaced.items()}
            self._replaced.clear()
        for name, (since, node) in list(self._leaving.items()):
            if self._looks - since >= STAY:
                node.remove()
                del self._leaving[name]

    def clear(self) -> None:
        """Remove all nodes now."""
        leaving = (node for _, node in self._leaving.values())
        for node in (*self._nodes.values(), *self._replaced.values(), *leaving):
            node.remove()
        self._nodes.clear()
        self._replaced.clear()
        self._leaving.clear()
