"""Meshes that the benchmark's scenes are made of."""

from collections.abc import Callable
from typing import cast

import numpy as np
import trimesh
from numpy.typing import NDArray
from sonar_sim import Material, Surface

FLOOR_CELL_M = 0.25
MEAN_DEPTH_M = 6.5

Floats = NDArray[np.float64]
Span = tuple[float, float]
Point = tuple[float, float, float]


def floor_height_m(x_m: Floats, y_m: Floats) -> Floats:
    """Height of the floor: long, low swells of sand."""
    swell: Floats = (
        0.10 * np.sin(0.6 * x_m + 0.3) * np.cos(0.45 * y_m)
        + 0.05 * np.sin(1.2 * y_m + 0.7 * x_m)
        - MEAN_DEPTH_M
    )
    return swell


def surface(name: str, mesh: trimesh.Trimesh, material: Material) -> Surface:
    """Give a mesh a name and a material."""
    vertices_m = np.asarray(mesh.vertices, dtype=np.float64)
    return Surface(name, vertices_m, np.asarray(mesh.faces, dtype=np.int64), material)


def floor(x_m: Span, y_m: Span, height_m: Callable[[Floats, Floats], Floats]) -> trimesh.Trimesh:
    """A sheet of triangles at a height that depends on x and y, both (M, N)."""
    x, y = (
        np.linspace(low, high, round((high - low) / FLOOR_CELL_M) + 1) for low, high in (x_m, y_m)
    )
    gx, gy = np.meshgrid(x, y, indexing="ij")
    return trimesh.Trimesh(
        np.stack([gx, gy, height_m(gx, gy)], axis=-1).reshape(-1, 3),
        _grid_faces(*gx.shape),
        process=False,
    )


def pile(middle_m: Point, radius_m: float, height_m: float) -> trimesh.Trimesh:
    """An upright cylinder with its ends."""
    tube = trimesh.creation.cylinder(radius=radius_m, height=height_m, sections=32)
    return _moved(cast("trimesh.Trimesh", tube), middle_m)


def box(middle_m: Point, edges_m: Point) -> trimesh.Trimesh:
    """A box along the axes."""
    return _moved(cast("trimesh.Trimesh", trimesh.creation.box(extents=edges_m)), middle_m)


def ball(middle_m: Point, radius_m: float) -> trimesh.Trimesh:
    """A sphere of 1280 triangles."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=radius_m)
    return _moved(cast("trimesh.Trimesh", sphere), middle_m)


def _moved(mesh: trimesh.Trimesh, middle_m: Point) -> trimesh.Trimesh:
    mesh.apply_translation(middle_m)
    return mesh


def _grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two triangles a cell of a grid of points, (F, 3)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
