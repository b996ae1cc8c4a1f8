import inspect
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd import OctreeMapper
from mapperd.errors import ExportError, MapError
from mapperd.mapping.queries import FREE, OCCUPIED

HIT = math.log(0.7 / 0.3)
UNIT = 2.0**-11  # of the log-odds that the map holds; every step is rounded to the nearest one


def near(expected: Any, updates: int = 1) -> Any:
    """Half a unit for each update; a probability has a slope of 1/4 at most in log-odds."""
    return pytest.approx(expected, rel=0, abs=updates * UNIT / 8)


def probability(mapper: OctreeMapper, point: tuple[float, float, float]) -> float:
    """Of the voxel whose centre is nearest to the point; it must be in the map."""
    voxels = mapper.get_occupied_voxels(0)
    distance = np.abs(voxels[:, :3] - point).max(axis=1)
    assert distance.min() <= mapper.get_resolution() / 2 + 1e-9
    return float(voxels[distance.argmin(), 3])


def test_names_and_defaults_are_the_published_ones() -> None:
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(OctreeMapper).parameters.items()
    }
    assert defaults == {
        "resolution": 0.05,
        "prob_hit": 0.7,
        "prob_miss": 0.3,
        "prob_thres_min": 0.12,
        "prob_thres_max": 0.97,
    }
    assert OctreeMapper().get_resolution() == 0.05


def test_hits_and_misses_add_up_to_their_limits() -> None:
    mapper = OctreeMapper()
    mapper.update_point((0.01, 0.02, 0.03), occupied=True)
    assert probability(mapper, (0.025, 0.025, 0.025)) == near(0.7)
    mapper.update_point((0.01, 0.02, 0.03), occupied=False)
    assert probability(mapper, (0.025, 0.025, 0.025)) == pytest.approx(0.5)
    mapper.batch_update([[0.01, 0.02, 0.03]] * 50, [True] * 50)
    assert probability(mapper, (0.025, 0.025, 0.025)) == near(0.97)  # of the clamp
    mapper.batch_update([[0.01, 0.02, 0.03]] * 50, np.zeros(50, dtype=bool))
    assert probability(mapper, (0.025, 0.025, 0.025)) == near(0.12)


def test_batch_equals_single_points() -> None:
    random = np.random.default_rng(1)
    points, flags = random.uniform(-0.2, 0.2, (400, 3)), random.random(400) > 0.5
    together, alone = OctreeMapper(), OctreeMapper()
    together.batch_update(points, flags)
    for point, flag in zip(points, flags, strict=True):
        alone.update_point(point, bool(flag))
    assert (together.get_occupied_voxels(0) == alone.get_occupied_voxels(0)).all()


def test_voxels_are_centres_above_the_probability_asked_for() -> None:
    mapper = OctreeMapper(resolution=0.1)
    points = [[0.0, 0.0, 0.0], [0.31, 0.39, -0.01], [1.0, 1.0, 1.0]]
    mapper.batch_update_with_log_odds(points, [2.0, 0.3, -1.0])
    assert mapper.get_occupied_voxels().shape == (2, 4)
    (strong,) = mapper.get_occupied_voxels(0.7)
    assert strong == pytest.approx([0.05, 0.05, 0.05, 1 / (1 + math.exp(-2))])
    assert len(mapper.get_occupied_voxels(0)) == 3
    assert len(mapper.get_occupied_voxels(1)) == 0
    for cell in mapper.get_occupied_voxels(0)[:, :3] / 0.1 - 0.5:
        assert cell == pytest.approx(np.round(cell), abs=1e-9)
    for bad in (1.1, math.nan):
        with pytest.raises(ValueError, match="min_probability"):
            mapper.get_occupied_voxels(bad)


def test_log_odds_are_absolute_and_clamped_at_ten() -> None:
    mapper = OctreeMapper()
    for value, expected in ((3.0, 3.0), (3.0, 3.0), (-50.0, -10.0), (50.0, 10.0)):
        mapper.batch_update_with_log_odds([[0, 0, 0]], [value])
        expected_probability = 1 / (1 + math.exp(-expected))
        assert probability(mapper, (0.025, 0.025, 0.025)) == pytest.approx(expected_probability)


def test_ray_frees_its_way_and_hits_its_end() -> None:
    mapper = OctreeMapper(resolution=0.1)
    mapper.insert_ray((0.05, 0.05, 0.05), (0.55, 0.05, 0.05))
    voxels = mapper.get_occupied_voxels(0)
    assert len(voxels) == 6
    assert voxels[np.argsort(voxels[:, 0]), 3] == near([0.3] * 5 + [0.7])
    classes = mapper.queries.classify([[0.05, 0.05, 0.05], [0.55, 0.05, 0.05]])
    assert classes.tolist() == [FREE, OCCUPIED]
    assert mapper.queries.ray_cast_depth([[0, 0.05, 0.05]], [[1, 0, 0]], 2.0) == pytest.approx(0.5)


def test_thresholds_are_clamps_and_nothing_else() -> None:
    mapper = OctreeMapper()
    mapper.set_occupancy_thresholds(0.4, 0.99995)
    mapper.set_probability_params(0.6, 0.45)
    mapper.update_point((0, 0, 0), occupied=True)
    assert len(mapper.get_occupied_voxels()) == 1  # far from saturated, and occupied
    mapper.batch_update([[0, 0, 0]] * 100, [False] * 100)
    assert probability(mapper, (0.025, 0.025, 0.025)) == near(0.4)
    for low, high in ((0.5, 0.9), (0.1, 0.5), (0.0, 0.9), (0.1, 1.0), (math.nan, 0.9)):
        with pytest.raises(ValueError, match="thresh"):
            mapper.set_occupancy_thresholds(low, high)
    for hit, miss in ((0.4, 0.3), (0.7, 0.6), (1.0, 0.3), (0.7, 0.0)):
        with pytest.raises(ValueError, match="prob_"):
            mapper.set_probability_params(hit, miss)


@pytest.mark.parametrize(
    ("method", "arguments"),
    [
        ("update_point", ([math.nan, 0, 0], True)),
        ("update_point", ([0, 0], True)),
        ("batch_update", ([[0, 0, 0], [0, math.inf, 0]], [True, True])),
        ("batch_update", ([[0, 0, 0], [1e30, 0, 0]], [True, True])),
        ("batch_update", ([[0, 0, 0]], [True, True])),
        ("batch_update", ([[0, 0, 0]], [0.7])),
        ("batch_update", ([[0, 0, 0]], [2])),
        ("batch_update_with_log_odds", ([[0, 0, 0]], [math.nan])),
        ("batch_update_with_log_odds", ([[0, 0, 0]], [1.0, 2.0])),
        ("insert_ray", ([0, 0, 0], [0, 0, math.nan])),
        ("insert_ray", ([0, 0, 0], [1e6, 0, 0])),
    ],
)
def test_what_is_refused_changes_nothing(method: str, arguments: tuple[Any, ...]) -> None:
    mapper = OctreeMapper()
    with pytest.raises(ValueError, match=r"\w"):
        getattr(mapper, method)(*arguments)
    assert mapper.get_num_nodes() == 0


def test_nothing_is_a_batch_too() -> None:
    mapper = OctreeMapper()
    mapper.batch_update([], [])
    mapper.batch_update_with_log_odds(np.empty((0, 3)), [])
    assert mapper.get_occupied_voxels().shape == (0, 4)


def test_memory_and_nodes_are_what_is_there() -> None:
    mapper = OctreeMapper()
    empty = mapper.get_memory_usage()
    assert (empty.num_nodes, empty.num_leaf_nodes, empty.memory_efficiency) == (0, 0, 0.0)
    points = np.random.default_rng(1).uniform(-5, 5, (5000, 3))
    mapper.batch_update(points, np.ones(5000, dtype=bool))
    full = mapper.get_memory_usage()
    assert full.num_leaf_nodes == len(mapper.get_occupied_voxels(0))
    assert full.num_nodes == mapper.get_num_nodes() > full.num_leaf_nodes
    assert full.memory_efficiency == full.num_leaf_nodes / full.num_nodes
    assert full.memory_mb > empty.memory_mb
    assert mapper.prune_tree() == 0
    mapper.clear()
    assert mapper.get_num_nodes() == 0
    assert mapper.get_memory_usage().memory_mb < full.memory_mb


def test_merged_maps_add_up() -> None:
    one, two, both = OctreeMapper(), OctreeMapper(), OctreeMapper()
    one.update_point((0, 0, 0), occupied=True)
    two.update_point((0, 0, 0), occupied=True)
    two.update_point((1, 1, 1), occupied=False)
    both.merge(one, two)
    two.merge(one)
    assert (both.get_occupied_voxels(0) == two.get_occupied_voxels(0)).all()
    assert probability(both, (0.025, 0.025, 0.025)) == near(1 / (1 + math.exp(-2 * HIT)), 2)
    with pytest.raises(ValueError, match="resolution"):
        one.merge(OctreeMapper(resolution=0.1))


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_saved_maps_come_back_and_answer(tmp_path: Path, suffix: str) -> None:
    mapper = OctreeMapper()
    random = np.random.default_rng(2)
    mapper.batch_update_with_log_odds(random.uniform(-1, 1, (500, 3)), random.uniform(-5, 5, 500))
    path = tmp_path / f"map{suffix}"
    assert mapper.save_to_file(path)
    loaded = OctreeMapper()
    loaded.update_point((50, 50, 50), occupied=True)
    assert loaded.load_from_file(str(path))
    before, after = mapper.get_occupied_voxels(), loaded.get_occupied_voxels()
    assert (after[:, :3] == before[:, :3]).all()
    assert len(loaded.get_occupied_voxels(0)) == len(mapper.get_occupied_voxels(0))
    if suffix == ".ot":
        assert after[:, 3] == pytest.approx(before[:, 3], abs=1e-6)
    again = tmp_path / f"again{suffix}"
    loaded.save_to_file(again)
    assert again.read_bytes() == path.read_bytes()


def test_files_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    mapper = OctreeMapper()
    mapper.update_point((0, 0, 0), occupied=True)
    with pytest.raises(ValueError, match=r"\.bt or \.ot"):
        mapper.save_to_file(tmp_path / "map.txt")
    with pytest.raises(ExportError, match="cannot be written"):
        mapper.save_to_file(tmp_path / "nowhere" / "map.bt")
    with pytest.raises(MapError, match="cannot be read"):
        mapper.load_from_file(tmp_path / "absent.bt")
    (tmp_path / "junk.bt").write_bytes(b"junk")
    with pytest.raises(MapError, match=r"junk\.bt"):
        mapper.load_from_file(tmp_path / "junk.bt")
    mapper.save_to_file(tmp_path / "fine.bt")
    with pytest.raises(MapError, match="voxels are"):
        OctreeMapper(resolution=0.1).load_from_file(tmp_path / "fine.bt")
    assert len(mapper.get_occupied_voxels()) == 1
    mapper.update_point((1e5, 0, 0), occupied=True)
    with pytest.raises(MapError) as caught:
        mapper.save_to_file(tmp_path / "far.bt")
    assert caught.value.reason == "out_of_reach"
    assert not (tmp_path / "far.bt").exists()
