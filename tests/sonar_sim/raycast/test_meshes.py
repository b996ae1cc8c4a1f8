"""Rays meet the scene's triangles, in whatever groups they move."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sonar_sim import _core
from sonar_sim.geometry.trajectory import Drift
from sonar_sim.raycast.meshes import NOTHING, Meshes
from sonar_sim.scene.scene import Scene, Sea, Surface
from sonar_sim.validation.setups import DULL


def spikes(rng: np.random.Generator, name: str) -> Surface:
    """Two long, thin triangles in opposite directions, somewhere."""
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [3.0, 0.0, 0.0]])
    vertices = Rotation.random(random_state=rng).apply(np.concatenate([corners, -corners]))
    drift = Drift(tuple(rng.uniform(-8.0, 8.0, 3)), yaw_deg=rng.uniform(-180.0, 180.0))
    return Surface(name, vertices, np.arange(6).reshape(2, 3), DULL, motion=drift)


@pytest.mark.parametrize("seed", range(6))
def test_a_short_reach_meets_what_a_long_one_meets_so_near(seed: int) -> None:
    """Groups out of reach are left out: no ray may miss what it reaches."""
    rng = np.random.default_rng(seed)
    surfaces = tuple(spikes(rng, f"spikes {number}") for number in range(4))
    meshes = Meshes(Scene(surfaces))
    corners = np.concatenate([surface.vertices_at_m(0.0) for surface in surfaces])
    # From beside the tips, towards a point of each triangle near its tip and anywhere else.
    aims = np.einsum("c,ncx->nx", [0.015, 0.005, 0.98], corners.reshape(-1, 3, 3))
    for tip, root in zip(corners[2::3], corners[0::3], strict=True):
        aside = np.cross(tip - root, rng.normal(size=3))
        origin = tip + 0.2 * (tip - root) / 3.0 + 0.1 * aside / np.linalg.norm(aside)
        rays = np.concatenate([aims - origin, rng.normal(size=(200, 3))])
        rays = (rays / np.linalg.norm(rays, axis=1)[:, None]).astype(np.float32)
        assert np.any(meshes.cast(origin, rays, 0.0, 1e4).range_m < 0.35)
        for origins in (origin, origin + rng.uniform(-0.005, 0.005, rays.shape)):
            everything = meshes.cast(origins, rays, 0.0, 1e4)
            for reach in (0.35, 2.0, 8.0):
                near = meshes.cast(origins, rays, 0.0, reach)
                expected = np.where(everything.range_m < reach, everything.face, NOTHING)
                assert np.array_equal(near.face, expected)


def rays_about(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    rays = rng.normal(size=(count, 3))
    unit: NDArray[np.float32] = (rays / np.linalg.norm(rays, axis=1)[:, None]).astype(np.float32)
    return unit


@pytest.fixture
def crowd() -> Meshes:
    """Triangles that stand still and others that move and turn, under the sea's surface."""
    rng = np.random.default_rng(11)
    moving = tuple(spikes(rng, f"spikes {number}") for number in range(3))
    vertices = rng.uniform(-9.0, 9.0, (60, 1, 3)) + rng.normal(size=(60, 3, 3))
    still = Surface("still", vertices.reshape(-1, 3), np.arange(180).reshape(60, 3), DULL)
    return Meshes(Scene((still, *moving), sea=Sea()))


def test_rays_of_one_origin_meet_what_embree_finds_for_each(crowd: Meshes) -> None:
    rng = np.random.default_rng(12)
    origin, rays = np.array([0.4, -0.3, -2.0]), rays_about(rng, 40_000)
    bundle = crowd.cast(origin, rays, 3.0, 12.0)
    each = crowd.cast(np.tile(origin, (len(rays), 1)), rays, 3.0, 12.0)
    differing = bundle.face != each.face
    # Rounding decides at an edge.
    assert np.count_nonzero(differing) < 5
    np.testing.assert_allclose(bundle.range_m[~differing], each.range_m[~differing], rtol=1e-4)
    np.testing.assert_array_equal(bundle.group[~differing], each.group[~differing])
    groups = set(bundle.group[bundle.face >= 0].tolist())
    assert {0, 1, 2, crowd.sea_group} <= groups
    assert np.isinf(bundle.range_m[bundle.face == NOTHING]).all()


def test_rays_go_on_behind_what_is_too_near(crowd: Meshes) -> None:
    """As if each began there, also for the sea's surface."""
    rng = np.random.default_rng(13)
    origin, rays = np.array([0.4, -0.3, -2.0]), rays_about(rng, 20_000)
    near_m = rng.uniform(0.5, 6.0, len(rays)).astype(np.float32)
    behind = crowd.cast(origin, rays, 3.0, 1e3, near_m=near_m)
    start = origin + near_m[:, None].astype(np.float64) * rays
    expected = crowd.cast(start, rays, 3.0, 1e3)
    under = start[:, 2] < 0.0
    differing = (behind.face != expected.face) & under
    assert np.count_nonzero(differing) < 5
    same = ~differing & under & (behind.face >= 0)
    np.testing.assert_allclose(
        behind.range_m[same], near_m[same] + expected.range_m[same], rtol=1e-4
    )
    assert not np.any(behind.face[~under] == len(crowd.planes) - 1)


def test_rays_of_several_origins_have_no_minimum_range(crowd: Meshes) -> None:
    rays = rays_about(np.random.default_rng(14), 4)
    with pytest.raises(ValueError, match="one origin"):
        crowd.cast(np.zeros((4, 3)), rays, 0.0, 1.0, near_m=np.ones(4, dtype=np.float32))


def test_no_rays_meet_nothing(crowd: Meshes) -> None:
    none = np.empty((0, 3), dtype=np.float32)
    assert len(crowd.cast(np.zeros(3), none, 0.0, 1.0).face) == 0
    assert len(crowd.cast(np.empty((0, 3)), none, 0.0, 1.0).face) == 0


@pytest.fixture
def wall() -> _core.TriangleTable:
    corners = np.array([[[2.0, -9, -9], [2, 9, -9], [2, 0, 9]]], dtype=np.float32)
    return _core.TriangleTable(corners)


def test_only_whole_arrays_are_written(wall: _core.TriangleTable) -> None:
    rays = np.tile(np.array([1.0, 0.0, 0.0], dtype=np.float32), (4, 1))
    face, range_m = np.full(4, -1, dtype=np.int32), np.full(8, 9.0, dtype=np.float32)
    for strided in (range_m[::2], range_m[3::-1], range_m[:4].astype(np.float64)):
        with pytest.raises(TypeError):
            wall.cast_bundle(np.zeros(3), rays, None, 0, strided, face, 1)  # type: ignore[arg-type]
    assert (range_m == 9.0).all()
    frozen = range_m[:4].copy()
    frozen.setflags(write=False)
    with pytest.raises(ValueError, match="writeable"):
        wall.cast_bundle(np.zeros(3), rays, None, 0, frozen, face, 1)
    for wrong in (rays.T.copy(), rays[:3], rays.ravel()):
        with pytest.raises(ValueError, match="direction"):
            wall.cast_bundle(np.zeros(3), wrong, None, 0, range_m[:4], face, 1)
    wall.cast_bundle(np.zeros(3), rays, None, 7, range_m[:4], face, 1)
    assert (face == 7).all()
    assert (range_m == [2, 2, 2, 2, 9, 9, 9, 9]).all()


@pytest.mark.parametrize("at", [np.nan, np.inf, 1e10])
def test_triangles_without_a_place_are_refused(at: float) -> None:
    corners = np.zeros((2, 3, 3), dtype=np.float32)
    corners[1, 2, 0] = at
    with pytest.raises(ValueError, match="corners_m"):
        _core.TriangleTable(corners)


def test_the_sea_is_met_by_whole_arrays_only() -> None:
    rays, face = np.ones((4, 3), np.float32), np.full(4, -1, np.int32)
    group, range_m = np.zeros(4, np.int32), np.full(4, 9.0, np.float32)
    for wrong in (np.ones((3, 4), np.float32), rays[:3], rays.ravel()):
        with pytest.raises(ValueError, match="direction"):
            _core.meet_sea(wrong, 1.0, None, 5, 2, range_m, face, group)
    with pytest.raises(TypeError):
        _core.meet_sea(rays, 1.0, None, 5, 2, range_m[::2], face, group)
    _core.meet_sea(rays, 1.0, None, 5, 2, range_m, face, group)
    assert (face == 5).all()
    assert (group == 2).all()


def test_a_box_has_two_corners() -> None:
    rays, reach_m = np.ones((4, 3), np.float32), np.full(4, 9.0)
    corners = np.array([[0.0, 0, 0], [1, 1, 1]])
    with pytest.raises(ValueError, match="box_m"):
        _core.box_crossing(corners.ravel(), np.zeros(3), rays, reach_m)
    for wrong in (np.ones((3, 4), np.float32), rays[:3]):
        with pytest.raises(ValueError, match="direction"):
            _core.box_crossing(corners, np.zeros(3), wrong, reach_m)


def test_rays_near_a_ball_need_a_start_each() -> None:
    rays = np.tile(np.array([1.0, 0.0, 0.0], dtype=np.float32), (3, 1))
    start = np.array([[0.0, 0, 0], [0, 2, 0], [4, 0, 0]])
    near = _core.rays_near_ball(start, rays, 3.0, np.array([3.5, 0, 0]), 1.0)
    assert near.tolist() == [0, 2]
    with pytest.raises(ValueError, match="start_m"):
        _core.rays_near_ball(start[:2], rays, 3.0, np.zeros(3), 1.0)


@pytest.mark.parametrize(("kind", "wide"), [(np.float32, 3), (np.float64, 3), (np.int32, 1)])
def test_rows_are_merged_in_order(kind: type[np.float32], wide: int) -> None:
    rng = np.random.default_rng(15)
    known = rng.normal(scale=99.0, size=(50, wide)).astype(kind).squeeze()
    source = rng.integers(-1, 50, 200).astype(np.int32)
    more = rng.normal(scale=99.0, size=(np.count_nonzero(source < 0), wide)).astype(kind).squeeze()
    expected = known[source]
    expected[source < 0] = more
    np.testing.assert_array_equal(_core.merged(known, source, more), expected)


def test_rows_that_do_not_fit_are_not_merged() -> None:
    known, source = np.zeros((4, 3), np.float32), np.array([0, -1], np.int32)
    for more in (np.zeros((2, 3), np.float32), np.zeros((1, 2), np.float32), np.zeros((1, 3))):
        with pytest.raises(ValueError, match="more"):
            _core.merged(known, source, more)  # type: ignore[type-var]
    with pytest.raises(ValueError, match="source"):
        _core.merged(known, np.array([4], np.int32), np.zeros((0, 3), np.float32))


def test_directions_are_multiplied_by_a_matrix() -> None:
    draw = np.random.default_rng(3)
    matrix = draw.normal(size=(3, 3)).astype(np.float32)
    for count in (0, 1, 7, 100):
        rows = draw.normal(size=(count, 3)).astype(np.float32)
        exact = rows.astype(np.float64) @ matrix.astype(np.float64)
        np.testing.assert_allclose(_core.rotated(rows, matrix), exact, atol=1e-5)
    with pytest.raises(ValueError, match="matrix"):
        _core.rotated(np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match="direction"):
        _core.rotated(np.zeros((3, 2), np.float32), matrix)
