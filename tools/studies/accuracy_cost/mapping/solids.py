"""Solids whose distance is known in closed form, and the meshes that the simulator hears of them.

The truth of a dive is made of these formulas alone, not of meshes: distances are exact in float64,
but for the floor, whose swells are so long that height over slope is exact within some millimetres
where anything is near.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
import trimesh
from numpy.typing import NDArray

__all__ = ["Box", "Floor", "Pile", "Solid", "World"]

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

FLOOR_CELL_M = 0.25
FACETS = 64


class Solid(Protocol):
    """Something that echoes."""

    def distance_m(self, points_m: Floats) -> Floats:
        """Signed distance (N,) of points (N, 3) to its surface, negative inside."""

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Vertices (V, 3) and faces (F, 3)."""


@dataclass(frozen=True, slots=True)
class Floor:
    """The sea's floor: all below long, low swells.

    Attributes:
        depth_m: of its mean.
        swell_m: amplitude of the larger swell; the smaller is half of it.
        half_m: half the edge of the part that the simulator hears.
        middle_m: of that part, x and y.
    """

    depth_m: float
    swell_m: float = 0.1
    half_m: float = 20.0
    middle_m: tuple[float, float] = (0.0, 0.0)

    def height_m(self, x_m: Floats, y_m: Floats) -> Floats:
        """Above the map's zero."""
        large = np.sin(0.6 * x_m + 0.3) * np.cos(0.45 * y_m)
        small = np.sin(1.2 * y_m + 0.7 * x_m)
        return np.asarray(self.swell_m * (large + 0.5 * small) - self.depth_m)

    def distance_m(self, points_m: Floats) -> Floats:
        """Height over the floor, by the slope under the point."""
        x, y, z = points_m.T
        along_x = 0.6 * np.cos(0.6 * x + 0.3) * np.cos(0.45 * y)
        along_x += 0.35 * np.cos(1.2 * y + 0.7 * x)
        along_y = -0.45 * np.sin(0.6 * x + 0.3) * np.sin(0.45 * y)
        along_y += 0.6 * np.cos(1.2 * y + 0.7 * x)
        slope = self.swell_m**2 * (along_x**2 + along_y**2)
        return np.asarray((z - self.height_m(x, y)) / np.sqrt(1.0 + slope))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """A sheet."""
        across = np.linspace(-self.half_m, self.half_m, round(2 * self.half_m / FLOOR_CELL_M) + 1)
        x, y = np.meshgrid(across + self.middle_m[0], across + self.middle_m[1], indexing="ij")
        vertices = np.stack([x, y, self.height_m(x, y)], axis=-1).reshape(-1, 3)
        index = np.arange(x.size).reshape(x.shape)
        a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
        c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        return vertices, faces


@dataclass(frozen=True, slots=True)
class Box:
    """Along the map's axes."""

    middle_m: Triple
    edges_m: Triple

    def distance_m(self, points_m: Floats) -> Floats:
        """Exact, inside as well."""
        beyond = np.abs(points_m - self.middle_m) - np.divide(self.edges_m, 2.0)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Twelve triangles."""
        return _moved(trimesh.creation.box(extents=self.edges_m), self.middle_m)


@dataclass(frozen=True, slots=True)
class Pile:
    """An upright cylinder with its ends."""

    middle_m: Triple
    radius_m: float
    height_m: float

    def distance_m(self, points_m: Floats) -> Floats:
        """Exact, inside as well."""
        off = points_m - self.middle_m
        aside = np.hypot(off[:, 0], off[:, 1]) - self.radius_m
        beyond = np.stack([aside, np.abs(off[:, 2]) - self.height_m / 2.0], axis=1)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Its facets lie within a thousandth of the radius of the cylinder."""
        tube = trimesh.creation.cylinder(self.radius_m, self.height_m, sections=FACETS)
        return _moved(cast("trimesh.Trimesh", tube), self.middle_m)


@dataclass(frozen=True, slots=True)
class World:
    """All solids of a dive."""

    solids: Sequence[Solid]

    def distance_m(self, points_m: Floats) -> Floats:
        """Signed distance (N,) of points (N, 3) to the nearest surface, negative inside a solid.

        Inside two solids at once the depth is that of the deeper one.
        """
        nearest = np.full(len(points_m), np.inf)
        for solid in self.solids:
            np.minimum(nearest, solid.distance_m(points_m), out=nearest)
        return nearest

    def touched(self, centres_m: Floats, edge_m: float, samples: int = 5) -> NDArray[np.bool_]:
        """Which voxels (N,) hold a part of a solid, of centres (N, 3).

        Where the distance of the centre does not decide it, the voxel is looked at in a lattice of
        `samples`³ points, its faces and corners among them: what reaches less than a quarter of an
        edge into it may be missed.
        """
        distance = self.distance_m(centres_m)
        touched = distance <= 0.0
        doubtful = np.flatnonzero((distance > 0.0) & (distance < np.sqrt(0.75) * edge_m))
        steps = np.linspace(-0.5, 0.5, samples) * edge_m
        offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        reached = np.zeros(len(doubtful), dtype=np.bool_)
        for offset in offsets[np.argsort(-np.abs(offsets).sum(axis=1))]:
            left = np.flatnonzero(~reached)
            reached[left] = self.distance_m(centres_m[doubtful[left]] + offset) <= 0.0
        touched[doubtful] = reached
        return touched


def _moved(mesh: trimesh.Trimesh, middle_m: Triple) -> tuple[Floats, NDArray[np.int64]]:
    vertices = np.asarray(mesh.vertices, dtype=np.float64) + middle_m
    return vertices, np.asarray(mesh.faces, dtype=np.int64)
