import math
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from mapperd import _core
from mapperd.mapping.queries import FREE, OCCUPIED, UNKNOWN, MapQueries

SIZE = 0.1
OCCUPIED_ABOVE = math.log(0.7 / 0.3)


def cube_map(seed: int, voxels: int, edge: int) -> _core.VoxelMap:
    """A map of voxels at random in -edge .. edge - 1."""
    random = np.random.default_rng(seed)
    core = _core.VoxelMap(SIZE, _core.IwloParams())
    points = (random.integers(-edge, edge, size=(voxels, 3)) + 0.5).astype(np.float64) * SIZE
    core.set_log_odds(points, random.uniform(-5, 5, voxels))
    return core


def asked(core: _core.VoxelMap) -> MapQueries:
    return MapQueries(core, occupied_threshold=0.7, free_threshold=0.5)


def centres(first: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(nx, ny, nz, 3) centres of a grid."""
    steps = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    return np.asarray(first + SIZE * steps)


@pytest.fixture(scope="module")
def core() -> _core.VoxelMap:
    return cube_map(1, 3000, 10)


def test_points_are_classified_as_the_map_reports(core: _core.VoxelMap) -> None:
    points = np.random.default_rng(2).uniform(-1.3, 1.3, size=(5000, 3))
    log_odds, count = core.query(points)
    expected = np.where(log_odds > OCCUPIED_ABOVE, OCCUPIED, np.where(log_odds < 0, FREE, UNKNOWN))
    expected[count == 0] = UNKNOWN
    states = asked(core).classify(points)
    assert states.dtype == np.int8
    assert (states == expected).all()
    assert set(np.unique(states)) == {UNKNOWN, FREE, OCCUPIED}


def test_box_equals_its_points(core: _core.VoxelMap) -> None:
    grid = asked(core).classify_box([-1.1, -0.5, 0.0], [1.2, 0.4, 0.7])
    assert grid.values.shape == (23, 9, 7)
    assert grid.first_centre_m == pytest.approx([-1.05, -0.45, 0.05])
    assert grid.resolution_m == SIZE
    points = centres(grid.first_centre_m, grid.values.shape)
    assert (asked(core).classify(points.reshape(-1, 3)) == grid.values.ravel()).all()


def test_rays_equal_fine_steps(core: _core.VoxelMap) -> None:
    random = np.random.default_rng(3)
    origins = random.uniform(-1.5, 1.5, size=(300, 3))
    units = random.normal(size=(300, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    depth = asked(core).ray_cast_depth(origins, 7.5 * units, 2.0)
    step = 1e-4
    along = np.arange(0.0, 2.0, step)
    hits = 0
    for origin, unit, found in zip(origins, units, depth, strict=True):
        solid = asked(core).classify(origin + along[:, None] * unit) == OCCUPIED
        stepped = along[solid.argmax()] if solid.any() else math.inf
        if found < 0:
            assert stepped == math.inf
            continue
        hits += 1
        # Steps come late by up to one, or miss a corner thinner than one: then it is a hair thick.
        if not found - 1e-9 <= stepped <= found + step + 1e-9:
            assert found < stepped
            inside = origin + (found + np.linspace(0, step, 101))[:, None] * unit
            assert (asked(core).classify(inside) == OCCUPIED).any()
    assert hits > 100
    assert depth.min() == -1


def test_batched_rays_equal_single_ones(core: _core.VoxelMap) -> None:
    random = np.random.default_rng(4)
    origins, directions = random.uniform(-1, 1, (50, 3)), random.normal(size=(50, 3))
    together = asked(core).ray_cast_depth(origins, directions, 1.0)
    alone = [
        asked(core).ray_cast_depth([o], [d], 1.0)[0]
        for o, d in zip(origins, directions, strict=True)
    ]
    assert together.tolist() == alone


@pytest.mark.parametrize("voxels", [0, 1, 8, 300])
@pytest.mark.parametrize("max_distance", [0.25, 0.8])
def test_distance_field_equals_scipy(voxels: int, max_distance: float) -> None:
    queries = asked(cube_map(5, voxels, 12))
    field = queries.distance_field([-0.6, -1.0, -0.4], [1.0, 0.9, 0.8], max_distance)
    wide = queries.classify_box([-3, -3, -3], [3, 3, 3])
    occupied = wide.values == OCCUPIED
    expected = np.full(occupied.shape, max_distance)
    if occupied.any():
        expected = np.minimum(distance_transform_edt(~occupied) * SIZE, max_distance)
    inside = expected[24:40, 20:39, 26:38]
    assert field.values.dtype == np.float32
    assert field.values == pytest.approx(inside, abs=1e-6)
    layer = queries.distance_slice([-0.6, -1.0], [1.0, 0.9], 0.33, max_distance)
    assert layer.values.shape == (16, 19, 1)
    assert (layer.values[:, :, 0] == field.values[:, :, 7]).all()
    assert layer.first_centre_m == pytest.approx([-0.55, -0.95, 0.35])


def test_occupied_voxels_of_a_region(core: _core.VoxelMap) -> None:
    low, high = np.array([-0.5, -0.4, -0.3]), np.array([0.4, 0.6, 0.8])
    found = asked(core).occupied_in(low, high)
    points, log_odds, count = core.voxels(min_log_odds=OCCUPIED_ABOVE)
    inside = ((points >= low) & (points < high)).all(axis=1)
    assert len(found) == inside.sum() > 50
    assert (found.centres_m == points[inside]).all()
    assert found.probability == pytest.approx(1 / (1 + np.exp(-log_odds[inside])))
    assert (found.count == count[inside]).all()


def test_known_voxels_are_counted(core: _core.VoxelMap) -> None:
    assert core.known_count() == len(core.voxels()[2])


@pytest.mark.parametrize(
    "ask",
    [
        lambda q: q.classify([[math.nan, 0, 0]]),
        lambda q: q.classify([[0, 0]]),
        lambda q: q.classify([["a", "b", "c"]]),
        lambda q: q.classify_box([0, 0, 0], [1e9, 1e9, 1e9]),
        lambda q: q.classify_box([0, 0, 0], [30, 60, 80]),
        lambda q: q.classify_box([1, 0, 0], [0, 1, 1]),
        lambda q: q.classify_box([0, 0], [1, 1, 1]),
        lambda q: q.ray_cast_depth([[0, 0, 0]], [[0, 0, 0]], 1.0),
        lambda q: q.ray_cast_depth([[0, 0, 0]], [[0, math.inf, 0]], 1.0),
        lambda q: q.ray_cast_depth([[0, 0, 0]], [[1, 0, 0], [0, 1, 0]], 1.0),
        lambda q: q.ray_cast_depth([[0, 0, 0]], [[1, 0, 0]], math.nan),
        lambda q: q.ray_cast_depth([[0, 0, 0]], [[1, 0, 0]], 1e9),
        lambda q: q.distance_field([0, 0, 0], [1, 1, 1], 0.0),
        lambda q: q.distance_field([0, 0, 0], [1, 1, 1], math.nan),
        lambda q: q.distance_field([0, 0, 0], [1, 1, 1], 30.0),
        lambda q: q.distance_field([0, 0, 0], [50, 50, 50], 1.0),
        lambda q: q.distance_slice([0, 0], [1, 1], math.nan, 1.0),
        lambda q: q.occupied_in([0, 0, math.nan], [1, 1, 1]),
    ],
)
def test_questions_that_make_no_sense_are_refused(core: _core.VoxelMap, ask: Any) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        ask(asked(core))


@pytest.mark.parametrize(
    ("occupied", "free"), [(0.0, 0.5), (1.0, 0.5), (0.7, 0.0), (0.4, 0.5), (math.nan, 0.5)]
)
def test_thresholds_are_checked(core: _core.VoxelMap, occupied: float, free: float) -> None:
    with pytest.raises(ValueError, match="threshold"):
        MapQueries(core, occupied_threshold=occupied, free_threshold=free)


def test_no_points_give_no_answers(core: _core.VoxelMap) -> None:
    assert asked(core).classify([]).shape == (0,)
    assert asked(core).ray_cast_depth([], [], 1.0).shape == (0,)
    assert asked(core).classify_box([0, 0, 0], [0, 1, 1]).values.shape == (0, 10, 10)
    assert len(asked(core).occupied_in([50, 50, 50], [51, 51, 51])) == 0


def test_merging_adds_and_its_order_does_not_matter() -> None:
    maps = [cube_map(seed, 2000, 8) for seed in (1, 2, 3)]
    results = []
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        whole = _core.VoxelMap(SIZE, _core.IwloParams())
        whole.merge(*(maps[i] for i in order))
        results.append(whole.voxels())
    for other in results[1:]:
        assert [a.tolist() for a in results[0]] == [b.tolist() for b in other]
    points, log_odds, count = results[0]
    parts = [one.query(points) for one in maps]
    expected = np.clip(sum(part[0].astype(np.float64) for part in parts), -10, 10)
    assert log_odds == pytest.approx(expected, abs=1e-6)
    assert count.tolist() == np.sum([part[1] for part in parts], axis=0).tolist()
    with pytest.raises(ValueError, match="resolution"):
        maps[0].merge(_core.VoxelMap(0.2, _core.IwloParams()))
    with pytest.raises(ValueError, match="itself"):
        maps[0].merge(maps[0])
    with pytest.raises(TypeError):
        maps[0].merge(None)  # type: ignore[arg-type]
