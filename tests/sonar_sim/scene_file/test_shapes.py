import math

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.shapes import sheet, triangles_of


def build(shape: schema.BuiltShape) -> trimesh.Trimesh:
    return triangles_of(shape, None)


def test_box_and_sphere_have_their_volume() -> None:
    assert build(schema.Box(size_m=(1.0, 2.0, 3.0))).volume == pytest.approx(6.0)
    sphere = build(schema.Sphere(radius_m=0.5, subdivisions=5))
    assert sphere.volume == pytest.approx(4.0 / 3.0 * math.pi * 0.125, rel=0.005)
    assert np.linalg.norm(sphere.vertices, axis=1) == pytest.approx(0.5)
    bent = build(schema.Sphere(radius_m=(1.0, 0.5, 0.25), subdivisions=5))
    assert np.abs(bent.vertices).max(axis=0) == pytest.approx([1.0, 0.5, 0.25], abs=0.01)


def test_cylinder_is_closed_or_a_tube_and_may_taper() -> None:
    whole = build(schema.Cylinder(radius_m=0.5, height_m=2.0, facets=256))
    assert whole.is_watertight
    assert abs(whole.volume) == pytest.approx(math.pi * 0.25 * 2.0, rel=0.001)
    tube = build(schema.Cylinder(radius_m=0.5, height_m=2.0, open=True, facets=256))
    assert not tube.is_watertight
    assert tube.area == pytest.approx(math.pi * 2.0, rel=0.001)
    assert np.linalg.norm(tube.vertices[:, :2], axis=1) == pytest.approx(0.5)
    cone = build(schema.Cylinder(radius_m=0.5, height_m=2.0, top_radius_m=0.0, facets=256))
    assert cone.is_watertight
    assert abs(cone.volume) == pytest.approx(math.pi * 0.25 * 2.0 / 3.0, rel=0.001)


@pytest.mark.parametrize("end_m", [(3.0, 4.0, 0.0), (0.0, 0.0, 5.0), (0.0, 0.0, -5.0)])
def test_capsule_is_all_at_its_radius_from_its_line(end_m: tuple[float, float, float]) -> None:
    rod = build(schema.Capsule(start_m=(0.0, 0.0, 0.0), end_m=end_m, radius_m=0.2))
    along = np.array(end_m) / 5.0
    place = np.clip(rod.vertices @ along, 0.0, 5.0)
    off = np.linalg.norm(rod.vertices - place[:, None] * along, axis=1)
    assert off == pytest.approx(0.2, abs=1e-9)
    assert rod.is_watertight


def test_pipe_keeps_its_radius_and_follows_the_floor() -> None:
    points = tuple((float(x), 0.0, 0.1) for x in range(11))
    shape = schema.Pipe(points_m=points, radius_m=0.3, follow_floor=True, facets=64)
    pipe = triangles_of(shape, lambda x_m, y_m: 0.02 * x_m + 0.0 * y_m - 7.0)
    axis_z = 0.02 * pipe.vertices[:, 0] - 6.9
    off = np.hypot(pipe.vertices[:, 1], pipe.vertices[:, 2] - axis_z)
    middle = (pipe.vertices[:, 0] > 0.1) & (pipe.vertices[:, 0] < 9.9)
    assert off[middle] == pytest.approx(0.3, abs=0.001)
    assert pipe.is_watertight


def test_pipe_may_stand_and_bend() -> None:
    bent = schema.Pipe(points_m=((0, 0, -5), (0, 0, -3), (2, 0, -1)), radius_m=0.1)
    assert np.isfinite(build(bent).vertices).all()


def test_hull_has_wigleys_lines() -> None:
    hull = build(schema.Hull(length_m=20.0, beam_m=4.0, draught_m=2.0, freeboard_m=1.0))
    assert hull.bounds[0] == pytest.approx([-10.0, -2.0, -2.0], abs=0.01)
    assert hull.bounds[1] == pytest.approx([10.0, 2.0, 1.0], abs=0.01)
    x, y, z = hull.vertices.T
    under = z <= 0.0
    wigley = 2.0 * (1.0 - (x / 10.0) ** 2) * (1.0 - (z / 2.0) ** 2)
    assert np.abs(y[under]) == pytest.approx(wigley[under])
    # Volume of the underwater part is 4/9 L B T; a deck closes what is above.
    assert hull.is_watertight
    assert abs(hull.volume) == pytest.approx(4 / 9 * 160.0 + 2 / 3 * 80.0, rel=0.01)


def test_sheet_and_disc_lie_flat() -> None:
    plate = build(schema.Sheet(size_m=(0.5, 0.6)))
    assert plate.area == pytest.approx(0.3)
    assert np.ptp(plate.vertices[:, 2]) == 0.0
    assert build(schema.Disc(radius_m=2.0, facets=512)).area == pytest.approx(4 * math.pi, rel=1e-3)


@pytest.mark.parametrize(
    "shape",
    [
        schema.Cylinder(radius_m=3.0, height_m=2.4, facets=180, open=True),
        schema.Cylinder(radius_m=1.0, height_m=2.0, top_radius_m=0.5, facets=48),
        schema.Disc(radius_m=3.0, facets=180),
    ],
)
def test_round_shapes_have_rings_as_their_cells_ask(shape: schema.BuiltShape) -> None:
    cell_m = 0.3
    whole, fine = build(shape), triangles_of(shape, None, cell_m)
    corners = fine.vertices[fine.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() <= cell_m
    assert fine.area == pytest.approx(whole.area, rel=1e-9)
    assert fine.bounds == pytest.approx(whole.bounds)
    assert len(fine.faces) < 30 * len(whole.faces)
    # Every edge is a border of the shape, or has two faces.
    whole_borders, borders = (
        np.unique(np.unique(m.edges_sorted, axis=0, return_counts=True)[1], return_counts=True)
        for m in (whole, fine)
    )
    assert borders[0].tolist() == whole_borders[0].tolist()
    if whole_borders[0][0] == 1:
        assert borders[1][0] == whole_borders[1][0]


def test_triangles_without_an_area_are_left_out() -> None:
    grid = np.zeros((2, 3, 3))
    grid[1, :, 0] = 1.0
    grid[:, 1, 1] = 1.0
    grid[:, 2, 1] = 1.0  # the second cell has no width
    assert len(sheet(grid).faces) == 2


@pytest.mark.parametrize(
    ("shape", "word"),
    [
        (schema.Sphere(radius_m=-1.0), "radius_m"),
        (schema.Capsule(start_m=(1, 1, 1), end_m=(1, 1, 1), radius_m=0.1), "same point"),
        (schema.Pipe(points_m=((0, 0, 0),), radius_m=0.1), "two points"),
        (schema.Pipe(points_m=((0, 0, 0), (0, 0, 0)), radius_m=0.1), "same point twice"),
        (
            schema.Pipe(points_m=((0, 0, 0), (1, 0, 0)), radius_m=0.1, follow_floor=True),
            "terrain",
        ),
    ],
)
def test_impossible_shape_is_refused(shape: schema.BuiltShape, word: str) -> None:
    with pytest.raises(SceneError, match=word):
        build(shape)
