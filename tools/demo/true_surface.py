"""Exact distance of points to a triangle mesh."""

import math
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

LARGEST_EDGE_M = 0.12
POINTS_A_TURN = 2000
"""Bounds the memory: each point brings some tens of triangles."""


class TrueSurface:
    """A mesh cut into small triangles, which a tree of their middles finds.

    A triangle nearer than a known upper bound has its middle within that bound plus the largest
    triangle's reach: so the search is exact, whatever the shape. Far from the surface that takes
    many triangles a point; there the triangle of the nearest middle may stand for all.

    Args:
        triangles_m: (F, 3, 3).
        exact_within_m: farther off, distances may be too large by a small triangle's reach, 7 cm.
    """

    def __init__(self, triangles_m: NDArray[np.float64], exact_within_m: float = math.inf) -> None:
        self._exact_within_m = exact_within_m
        faces = np.arange(3 * len(triangles_m)).reshape(-1, 3)
        vertices, small = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
            triangles_m.reshape(-1, 3), faces, LARGEST_EDGE_M
        )
        self.triangles_m: NDArray[np.float64] = np.asarray(vertices[small], dtype=np.float64)
        middles = self.triangles_m.mean(axis=1)
        self._reach_m = float(
            np.linalg.norm(self.triangles_m - middles[:, None], axis=2).max(initial=0.0)
        )
        self._tree = cKDTree(middles)

    def distance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of each point (N, 3) to the nearest triangle, (N,)."""
        turns = range(0, len(points_m), POINTS_A_TURN)
        parts = [self._distance_m(points_m[i : i + POINTS_A_TURN]) for i in turns]
        return np.concatenate(parts) if parts else np.empty(0)

    def _distance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        _, nearest = self._tree.query(points_m)
        bound = _to_triangles(points_m, self.triangles_m[nearest])
        close = bound <= self._exact_within_m
        bound[close] = self._smallest(points_m[close], bound[close])
        return bound

    def _smallest(
        self, points_m: NDArray[np.float64], bound: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Exact distance of points whose distance is at most `bound`."""
        if len(points_m) == 0:
            return bound
        near = self._tree.query_ball_point(points_m, bound + self._reach_m)
        counts = np.array([len(found) for found in near])
        triangles = self.triangles_m[np.concatenate([np.asarray(f, dtype=int) for f in near])]
        distance = _to_triangles(np.repeat(points_m, counts, axis=0), triangles)
        starts = np.cumsum(counts) - counts
        smallest: NDArray[np.float64] = np.minimum.reduceat(distance, starts)
        return smallest


def read_triangles(path: Path) -> NDArray[np.float64]:
    """Read the triangles (F, 3, 3) of a file that trimesh knows."""
    mesh = trimesh.load_mesh(path, process=False)
    return np.asarray(mesh.triangles, dtype=np.float64)


def _to_triangles(
    points_m: NDArray[np.float64], triangles_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    closest = trimesh.triangles.closest_point(triangles_m, points_m)  # type: ignore[no-untyped-call]
    distance: NDArray[np.float64] = np.linalg.norm(points_m - closest, axis=1)
    return distance
