"""Outlines: cells of rays are cut along them, and every part is met."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from sonar_sim import _core
from sonar_sim.geometry.pose import FramePose
from sonar_sim.raycast.fan import RayFan, ray_fan
from sonar_sim.raycast.meshes import Meshes
from sonar_sim.raycast.tracing import Trace, trace
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.setups import CHALK, pose_at, rectangle, sphere

SONAR = SonarSettings(beams=64, demanded_range_m=12.0, forced_rows=200)
ORIGIN = pose_at((0.0, 0.0, 0.0))
RNG = np.random.default_rng(3)
PLATES = [(0.3, 1.0), (0.05, 1.0), (0.01, 1.0), (0.002, 1.0), (0.03, 20.0), (0.005, 50.0)]


def traced(scene: Scene, pose: FramePose = ORIGIN) -> Trace:
    return trace(Meshes(scene), ray_fan(SONAR), pose, 0.0, 15.0)


def whole_area(fan: RayFan) -> NDArray[np.float64]:
    """ds dw of each column's cells, (columns,)."""
    cell = fan.cell.astype(np.float64)
    area = (cell[:, 1] - cell[:, 0]) * (cell[:, 3] - cell[:, 2])
    total: NDArray[np.float64] = np.bincount(fan.column, area, fan.columns).astype(np.float64)
    return total


def area_of(rays: Trace) -> float:
    """ds dw of the cells of rays that met something."""
    cell = rays.fan.cell[rays.met[0].face >= 0].astype(np.float64)
    return float(((cell[:, 1] - cell[:, 0]) * (cell[:, 3] - cell[:, 2])).sum())


def polygon_area(corners: NDArray[np.float64]) -> float:
    """ds dw of a polygon whose corners are given in the sonar's frame, in order."""
    along = np.concatenate([corners, corners[:1]])
    part = np.linspace(0.0, 1.0, 200, endpoint=False)[:, None]
    fine = np.concatenate([a + part * (b - a) for a, b in itertools.pairwise(along)])
    unit = fine / np.linalg.norm(fine, axis=1, keepdims=True)
    s, w = -unit[:, 1], unit[:, 2]
    return abs(float(np.sum(s * np.roll(w, -1) - w * np.roll(s, -1)))) / 2.0


def scattered() -> Scene:
    """Boxes, a ball and a floor that overlap as seen from the origin."""
    random = np.random.default_rng(4)
    surfaces = [rectangle((0, 0, -2), (40, 0, 0), (0, 40, 0)), sphere((5, 1, 0), 0.3, CHALK)]
    for number in range(6):
        box = trimesh.creation.box(random.uniform(0.02, 0.8, 3))
        at = random.uniform((3, -4, -2), (9, 4, 1))
        surfaces.append(Surface(f"box{number}", np.asarray(box.vertices) + at, box.faces, CHALK))
    return Scene(tuple(replace(s, name=f"{i}") for i, s in enumerate(surfaces)))


def test_cut_cells_cover_what_they_did_before() -> None:
    fan = traced(scattered()).fan
    assert len(fan.directions) > len(ray_fan(SONAR).directions) + 1000
    assert whole_area(fan) == pytest.approx(whole_area(ray_fan(SONAR)), rel=1e-4)
    cell, direction = fan.cell, fan.directions
    assert (cell[:, 1] > cell[:, 0]).all()
    assert (cell[:, 3] > cell[:, 2]).all()
    inside = np.abs(direction[:, 1]) < 0.7
    assert (-direction[inside, 1] > cell[inside, 0] - 1e-6).all()
    assert (-direction[inside, 1] < cell[inside, 1] + 1e-6).all()


def test_rays_come_column_by_column_and_the_known_ones_are_kept() -> None:
    fan = ray_fan(SONAR)
    rays = traced(scattered())
    assert (np.diff(rays.fan.column) >= 0).all()
    alone = Meshes(scattered()).cast(ORIGIN.position_m, rays.direction, 0.0, 15.0)
    np.testing.assert_array_equal(rays.met[0].face, alone.face)
    assert np.isin(fan.directions[:, 2], rays.fan.directions[:, 2]).mean() > 0.8


@pytest.mark.parametrize(("size_m", "long"), PLATES)
def test_a_plate_of_any_size_and_place_has_its_own_solid_angle(size_m: float, long: float) -> None:
    for _ in range(12):
        u, v = RNG.normal(size=(2, 3))
        u *= size_m / np.linalg.norm(u)
        v = np.cross(u, v)
        v *= long * size_m / np.linalg.norm(v)
        at = RNG.uniform((4, -4, -1.5), (10, 4, 1.5))
        facing = abs(np.dot(np.cross(u, v), at)) / np.linalg.norm(np.cross(u, v)) / 10.0
        if facing < 0.1:
            continue
        corners = np.array([at - u - v, at + u - v, at + u + v, at - u + v]) / 1.0
        plate = rectangle(tuple(at), tuple(2 * u), tuple(2 * v))
        got = area_of(traced(Scene((plate,))))
        assert got == pytest.approx(polygon_area(corners), rel=0.03)


def test_a_ball_that_moves_and_turns_is_met_where_it_is() -> None:
    class Circling:
        def pose(self, time_s: float) -> FramePose:
            c, s = math.cos(time_s), math.sin(time_s)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            return FramePose(np.array([8.0, 0.3 * time_s, 0.0]), turn)

    ball = replace(sphere((0.0, 0.5, 0.0), 0.02, CHALK), motion=Circling())
    meshes, fan = Meshes(Scene((ball,))), ray_fan(SONAR)
    for time_s in np.linspace(0.0, 3.0, 7):
        rays = trace(meshes, fan, ORIGIN, float(time_s), 15.0)
        met = rays.met[0].face >= 0
        centre = Circling().pose(float(time_s))
        at = centre.position_m + centre.rotation @ np.array([0.0, 0.5, 0.0])
        # Its outline is a circle, which s and w show as an ellipse, shorter by what is ahead.
        wanted = math.pi * (0.02 / np.linalg.norm(at)) ** 2 * at[0] / np.linalg.norm(at)
        assert area_of(rays) == pytest.approx(wanted, rel=0.05)
        assert rays.met[0].range_m[met] == pytest.approx(np.linalg.norm(at), abs=0.025)


def test_hidden_outlines_cost_no_rays() -> None:
    wall = rectangle((3, 0, 0), (0, 20, 0), (0, 0, 20))
    ball = sphere((6, 0, 0), 0.5, CHALK)
    bare = len(traced(Scene((wall,))).fan.directions)
    assert len(traced(Scene((wall, replace(ball, name="ball")))).fan.directions) == bare


def test_edges_within_a_plane_are_no_edges() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    corners = np.asarray(box.triangles, dtype=np.float32)
    normals = np.asarray(box.face_normals, dtype=np.float32)
    table = _core.EdgeTable(corners, normals, np.zeros(len(corners), dtype=np.int32))
    assert len(table) == 12 * 4


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="corners_m must be"):
        _core.EdgeTable(*(np.zeros((2, 3), np.float32),) * 2, np.zeros(3, np.int32))
    table = _core.EdgeTable(*(np.zeros((0, 3), np.float32),) * 2, np.zeros(0, np.int32))
    with pytest.raises(ValueError, match="pose must be"):
        _core.MeshView(table, np.zeros(12))
    fan = ray_fan(SONAR)
    with pytest.raises(ValueError, match="direction must be"):
        _core.refined_rays(
            fan.directions[:-1],
            fan.cell,
            np.zeros(len(fan.cell), np.float32),
            fan.grid.row_edges,
            fan.grid.rays,
            0.0,
            0.01,
            [],
            np.zeros(0, np.int64),
            9.0,
            np.empty((0, 2)),
            np.zeros(4),
        )
