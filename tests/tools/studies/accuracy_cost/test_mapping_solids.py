"""The truth of the dives: closed forms against brute force over the meshes that are heard."""

import numpy as np
import pytest
import trimesh
from studies.accuracy_cost.mapping.metrics import Floor, Pile, Solid, SolidBox, Solids

AROUND = np.random.default_rng(5).uniform(-2.5, 2.5, (120, 3))


def to_mesh(solid: Solid, points_m: np.ndarray) -> np.ndarray:
    vertices, faces = solid.mesh()
    nearest = np.full(len(points_m), np.inf)
    for triangle in vertices[faces]:
        each = np.broadcast_to(triangle, (len(points_m), 3, 3))
        closest = trimesh.triangles.closest_point(each, points_m)  # type: ignore[no-untyped-call]
        nearest = np.minimum(nearest, np.linalg.norm(points_m - closest, axis=1))
    return nearest


@pytest.mark.parametrize(
    ("solid", "within_m"),
    [
        (SolidBox((0.3, -0.2, 0.1), (1.0, 2.0, 0.6)), 1e-9),
        (Pile((0.1, 0.2, -0.3), 0.7, 1.8), 1.5e-3),
        (Floor(0.2, swell_m=0.1, half_m=4.0), 0.03),
    ],
)
def test_distance_is_that_to_the_mesh(solid: Solid, within_m: float) -> None:
    stated = solid.distance_m(AROUND)
    assert np.abs(stated) == pytest.approx(to_mesh(solid, AROUND), abs=within_m)


@pytest.mark.parametrize("off_m", [-0.2, 0.1])
def test_distance_to_a_slope_is_along_its_normal(off_m: float) -> None:
    floor, step = Floor(3.0, swell_m=0.2), 1e-5
    x, y = AROUND[:, 0], AROUND[:, 1]
    height = floor.height_m(x, y)
    along_x = (floor.height_m(x + step, y) - floor.height_m(x - step, y)) / (2 * step)
    along_y = (floor.height_m(x, y + step) - floor.height_m(x, y - step)) / (2 * step)
    normal = np.stack([-along_x, -along_y, np.ones_like(x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    points = np.stack([x, y, height], axis=1) + off_m * normal
    assert floor.distance_m(points) == pytest.approx(np.full(len(x), off_m), abs=7e-4)


def test_inside_is_negative() -> None:
    box, pile = SolidBox((0, 0, 0), (1.0, 1.0, 1.0)), Pile((0, 0, 0), 0.5, 1.0)
    points = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.6, 0.0, 0.0]])
    assert box.distance_m(points) == pytest.approx([-0.5, -0.1, 0.1])
    assert pile.distance_m(points) == pytest.approx([-0.5, -0.1, 0.1])
    assert (Floor(1.0).distance_m(np.array([[0.0, 0.0, -3.0], [0.0, 0.0, 1.0]])) < 0).tolist() == [
        True,
        False,
    ]


def test_the_nearest_solid_counts() -> None:
    world = Solids((SolidBox((0, 0, 0), (1.0, 1.0, 1.0)), SolidBox((3.0, 0, 0), (1.0, 1.0, 1.0))))
    assert world.distance_m(np.array([[1.0, 0, 0], [2.2, 0, 0]])) == pytest.approx([0.5, 0.3])


def test_a_voxel_is_solid_when_a_corner_of_it_is() -> None:
    world = Solids((SolidBox((0.0, 0.0, -0.5), (10.0, 10.0, 1.0)),))
    heights = np.array([-0.5, -0.05, 0.04, 0.049, 0.051, 0.5])
    centres = np.stack([np.zeros(6), np.zeros(6), heights], axis=1)
    assert world.touched(centres, 0.1).tolist() == [True, True, True, True, False, False]


def test_a_pole_through_the_middle_of_a_voxel_is_found() -> None:
    world = Solids((Pile((0.0, 0.0, 0.0), 0.03, 4.0),))
    assert world.touched(np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]), 0.4).tolist() == [
        True,
        False,
    ]
    beside = np.array([[0.19, 0.19, 0.0]])  # no corner of this voxel is near the pole
    assert world.touched(beside, 0.4).tolist() == [True]
