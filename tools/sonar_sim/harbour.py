"""The demo's scene: a quay, a row of piles before it and a wreck on a sandy floor.

Faces that nothing can ever see (below the floor, floor inside the wreck) are left out, so that a
map's voxel beside one of them is not taken for a good one.
"""

import math
from typing import cast

import numpy as np
import trimesh
from numpy.typing import NDArray

from sonar_sim.poses import rotation_of
from sonar_sim.scene import Material, Scene, Surface

MEAN_DEPTH_M = 6.5
FLOOR_X_M = (-7.6, 7.6)
FLOOR_Y_M = (-6.4, 4.4)
QUAY_Y_M = FLOOR_Y_M[1]
FLOOR_CELL_M = 0.2
PILES_XY_M = ((-4.2, 2.8), (-1.4, 2.8), (1.4, 2.8), (4.2, 2.8))
PILE_RADIUS_M = 0.2
PILE_FACETS = 32
WRECK_SIZE_M = (3.0, 1.5, 1.3)
WRECK_CENTRE_M = (0.1, -1.4, -6.1)
WRECK_ROLL_PITCH_YAW_DEG = (12.0, 5.0, 20.0)
WRECK_CELL_M = 0.1


def harbour() -> Scene:
    """Build the scene; the same every time."""
    wreck = _wreck()
    floor = _floor()
    buried = np.all(wreck.contains(floor.vertices)[floor.faces], axis=1)
    floor.update_faces(~buried)
    sunk = np.all(_below_floor(wreck.vertices)[wreck.faces], axis=1)
    wreck.update_faces(~sunk)
    piles = [
        _surface(f"pile {i}", _pile(x, y), Material.OVERGROWN_CONCRETE)
        for i, (x, y) in enumerate(PILES_XY_M, start=1)
    ]
    return Scene(
        (
            _surface("floor", floor, Material.SAND),
            _surface("quay", _quay(), Material.SHEET_PILING),
            _surface("wreck", wreck, Material.RUSTY_STEEL),
            *piles,
        )
    )


def floor_height_m(x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the floor: long, low swells of sand."""
    swell: NDArray[np.float64] = (
        0.10 * np.sin(0.6 * x_m + 0.3) * np.cos(0.45 * y_m)
        + 0.05 * np.sin(1.2 * y_m + 0.7 * x_m)
        - MEAN_DEPTH_M
    )
    return swell


def _below_floor(points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    below: NDArray[np.bool_] = points_m[:, 2] < floor_height_m(points_m[:, 0], points_m[:, 1])
    return below


def _surface(name: str, mesh: trimesh.Trimesh, material: Material) -> Surface:
    return Surface(
        name,
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        material,
    )


def _floor() -> trimesh.Trimesh:
    x = _steps(*FLOOR_X_M)
    y = _steps(*FLOOR_Y_M)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    return _sheet(np.stack([gx, gy, floor_height_m(gx, gy)], axis=-1))


def _quay() -> trimesh.Trimesh:
    """A wall that stands on the floor and ends at the water's surface."""
    x = _steps(*FLOOR_X_M)
    foot = floor_height_m(x, np.full_like(x, QUAY_Y_M))
    share = np.linspace(0.0, 1.0, 9)
    z = foot[:, None] * (1.0 - share)
    gx = np.broadcast_to(x[:, None], z.shape)
    return _sheet(np.stack([gx, np.full_like(z, QUAY_Y_M), z], axis=-1))


def _pile(x_m: float, y_m: float) -> trimesh.Trimesh:
    """A round pile without its ends, from the floor to the water's surface."""
    angle = np.linspace(0.0, 2.0 * math.pi, PILE_FACETS + 1)
    px, py = x_m + PILE_RADIUS_M * np.cos(angle), y_m + PILE_RADIUS_M * np.sin(angle)
    foot = np.stack([px, py, floor_height_m(px, py)], axis=-1)
    head = np.stack([px, py, np.zeros_like(px)], axis=-1)
    return _sheet(np.stack([foot, head], axis=1))


def _wreck() -> trimesh.Trimesh:
    box = trimesh.creation.box(extents=WRECK_SIZE_M)
    mesh = cast("trimesh.Trimesh", box.subdivide_to_size(WRECK_CELL_M))
    transform = np.eye(4)
    transform[:3, :3] = rotation_of(*np.radians(WRECK_ROLL_PITCH_YAW_DEG))
    transform[:3, 3] = WRECK_CENTRE_M
    mesh.apply_transform(transform)
    return mesh


def _steps(start_m: float, end_m: float) -> NDArray[np.float64]:
    return np.linspace(start_m, end_m, round((end_m - start_m) / FLOOR_CELL_M) + 1)


def _sheet(points_m: NDArray[np.float64]) -> trimesh.Trimesh:
    """Triangles between the points of a grid, (M, N, 3)."""
    m, n = points_m.shape[:2]
    index = np.arange(m * n).reshape(m, n)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return trimesh.Trimesh(points_m.reshape(-1, 3), faces, process=False)
