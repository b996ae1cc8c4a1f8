"""The benchmark's scene and path: a harbour basin with something in sight at 30 m.

The demo's harbour ends 8 m from its middle; a survey that looks ahead at 30 m needs more of the
same: a sandy floor 4 m below the sonar, quays on two sides, rows of piles before them, and caissons
on the floor.
"""

import math
from typing import cast

import numpy as np
import trimesh
from numpy.typing import NDArray
from sonar_sim import Material, Motion, Mounting, Scene, Surface, Trajectory, Waypoint
from sonar_sim.harbour import floor_height_m

FLOOR_X_M = (-30.0, 28.0)
FLOOR_Y_M = (-28.0, 30.0)
FLOOR_CELL_M = 0.25
SONAR_Z_M = -2.5
"""4 m above the mean floor."""
QUAY_X_M, QUAY_Y_M = 27.0, 29.0
PILE_RADIUS_M = 0.3
PILES_XY_M = (
    *((22.0, float(y)) for y in range(-20, 24, 4)),
    *((float(x), 24.0) for x in range(-18, 22, 4)),
    *((6.5, -3.5), (8.0, 5.5), (12.0, 1.0), (1.5, 10.0)),
)
CAISSONS_M = (
    ((10.0, -4.0, -6.0), (3.0, 2.0, 2.6)),
    ((15.0, 9.0, -6.0), (4.0, 4.0, 3.4)),
    ((-4.0, 16.0, -6.0), (5.0, 3.0, 3.0)),
    ((5.0, 15.0, -6.0), (2.0, 2.0, 2.0)),
)
"""Centres and edges."""


def basin() -> Scene:
    """Build the scene; the same every time."""
    piles = [
        _surface(f"pile {i}", _pile(x, y), Material.OVERGROWN_CONCRETE)
        for i, (x, y) in enumerate(PILES_XY_M, start=1)
    ]
    caissons = [
        _surface(f"caisson {i}", _box(centre_m, edges_m), Material.OVERGROWN_CONCRETE)
        for i, (centre_m, edges_m) in enumerate(CAISSONS_M, start=1)
    ]
    east = _box((QUAY_X_M + 0.5, 0.0, -4.0), (1.0, 60.0, 8.0))
    north = _box((0.0, QUAY_Y_M + 0.5, -4.0), (60.0, 1.0, 8.0))
    return Scene(
        (
            _surface("floor", _floor(), Material.SAND),
            _surface("east quay", east, Material.SHEET_PILING),
            _surface("north quay", north, Material.SHEET_PILING),
            *piles,
            *caissons,
        )
    )


def mounting(pitch_deg: float) -> Mounting:
    """A sonar that looks ahead, tilted down."""
    return Mounting(position_m=(0.0, 0.0, 0.0), pitch_deg=pitch_deg)


def path() -> Trajectory:
    """Ten metres: one straight ahead, then a quarter turn to port."""
    radius_m = 9.0 / (math.pi / 2.0)
    turn = [
        Waypoint(
            1.0 + radius_m * math.sin(math.radians(yaw_deg)),
            radius_m * (1.0 - math.cos(math.radians(yaw_deg))),
            SONAR_Z_M,
            yaw_deg,
        )
        for yaw_deg in range(0, 91, 10)
    ]
    return Trajectory([Waypoint(0.0, 0.0, SONAR_Z_M, 0.0), *turn], Motion(speed_mps=0.5))


def _surface(name: str, mesh: trimesh.Trimesh, material: Material) -> Surface:
    vertices_m = np.asarray(mesh.vertices, dtype=np.float64)
    return Surface(name, vertices_m, np.asarray(mesh.faces, dtype=np.int64), material)


def _floor() -> trimesh.Trimesh:
    x, y = (
        np.linspace(low, high, round((high - low) / FLOOR_CELL_M) + 1)
        for low, high in (FLOOR_X_M, FLOOR_Y_M)
    )
    gx, gy = np.meshgrid(x, y, indexing="ij")
    return trimesh.Trimesh(
        np.stack([gx, gy, floor_height_m(gx, gy)], axis=-1).reshape(-1, 3),
        _grid_faces(*gx.shape),
        process=False,
    )


def _grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two triangles a cell of a grid of points, (F, 3)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _pile(x_m: float, y_m: float) -> trimesh.Trimesh:
    tube = trimesh.creation.cylinder(radius=PILE_RADIUS_M, height=8.0, sections=32)
    mesh = cast("trimesh.Trimesh", tube)
    mesh.apply_translation((x_m, y_m, -4.0))
    return mesh


def _box(
    centre_m: tuple[float, float, float], edges_m: tuple[float, float, float]
) -> trimesh.Trimesh:
    mesh = cast("trimesh.Trimesh", trimesh.creation.box(extents=edges_m))
    mesh.apply_translation(centre_m)
    return mesh
