"""Two maps against each other."""

import numpy as np
import pytest
from scipy import ndimage

from mapperd.config.tree import Config, OctreeConfig
from mapperd.errors import MapError
from mapperd.mapping.difference import changes_among, changes_of, compare_maps
from mapperd.mapping.sonar_map import SonarMap


def map_of(occupied: object, free: object = (), *, edge_m: float = 0.25) -> SonarMap:
    config = Config(octree=OctreeConfig(voxel_resolution=edge_m))
    sonar_map = SonarMap(config)
    for points, log_odds in ((occupied, 3.0), (free, -2.0)):
        at = np.array(points, dtype=np.float64).reshape(-1, 3)
        if len(at):
            sonar_map.core.set_log_odds(at, np.full(len(at), log_odds))
    return sonar_map


def test_same_appeared_vanished_and_not_seen_are_counted() -> None:
    wall = [(x, 0.125, 0.125) for x in np.arange(0.125, 5, 0.25)]
    box, rock, far = (2.125, 3.125, 0.125), (3.125, -3.125, 0.125), (40.125, 0.125, 0.125)
    first = map_of([*wall, rock], [box])
    second = map_of([*wall, box, far], [rock])
    found = compare_maps(first, second, 0.5)
    a, b = found.vanished, found.appeared
    assert (a.same.sum(), a.changed.sum(), (~a.seen).sum()) == (20, 1, 0)
    assert (b.same.sum(), b.changed.sum(), (~b.seen).sum()) == (20, 1, 1)
    np.testing.assert_allclose(a.centres_m[a.changed], [rock])
    np.testing.assert_allclose(b.centres_m[b.changed], [box])
    assert (a.quantile_m(0.5), a.quantile_m(0.95), a.quantile_m(1.0)) == (0.0, 0.0, None)


@pytest.mark.parametrize("shift_m", [0.25, 0.5, 0.75])
def test_distances_are_those_of_every_pair(shift_m: float) -> None:
    chance = np.random.default_rng(1)
    one = np.unique(chance.integers(-200, 200, (500, 3)), axis=0) * 0.25 + 0.125
    other = np.unique(chance.integers(-200, 200, (500, 3)), axis=0) * 0.25 + 0.125
    other = np.concatenate([other, one[:100] + np.array([shift_m, 0, 0])])
    found = compare_maps(map_of(one), map_of(other), 0.5)
    way = found.vanished
    gaps = np.linalg.norm(way.centres_m[:, None] - other[None], axis=2).min(axis=1)
    within = gaps <= found.reach_m
    np.testing.assert_allclose(way.distance_m[within], gaps[within], atol=1e-6)
    assert np.isinf(way.distance_m[~within]).all()
    np.testing.assert_array_equal(way.same, gaps <= 0.5 + 1e-9)


def test_maps_of_different_resolution_are_compared_by_metres() -> None:
    x, y = np.meshgrid(np.arange(0.025, 4, 0.05), np.arange(0.025, 4, 0.05))
    fine = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.975)])
    coarse = np.unique(np.floor(fine / 0.2), axis=0) * 0.2 + 0.1
    found = compare_maps(map_of(fine, edge_m=0.05), map_of(coarse, edge_m=0.2), 0.1)
    assert found.grid_m == 0.2
    assert found.vanished.same.all()
    assert found.appeared.same.all()
    raised = compare_maps(
        map_of(fine, edge_m=0.05), map_of(coarse + np.array([0, 0, 0.4]), edge_m=0.2), 0.3
    )
    assert not raised.vanished.same.any()
    assert raised.appeared.quantile_m(0.5) is None  # the finer map has not looked there
    np.testing.assert_allclose(raised.appeared.distance_m, 0.4, atol=1e-6)


def test_empty_maps_and_bad_tolerances() -> None:
    empty, one = map_of([]), map_of([(0.1, 0.1, 0.1)])
    assert len(compare_maps(empty, empty).vanished.same) == 0
    assert not compare_maps(empty, one).appeared.seen.any()
    for tolerance_m in (0.0, -1.0, float("nan"), 16.0):
        with pytest.raises(MapError, match="tolerance"):
            compare_maps(one, one, tolerance_m)


def test_changes_are_the_groups_of_voxels_that_touch() -> None:
    random = np.random.default_rng(6)
    cells = random.random((20, 20, 20)) < 0.04
    cells[3:6, 3:6, 3:6] = True
    labels, count = ndimage.label(cells, structure=np.ones((3, 3, 3)))
    expected = sorted(
        (
            tuple((np.argwhere(labels == number).min(axis=0) * 0.25).tolist()),
            tuple(((np.argwhere(labels == number).max(axis=0) + 1) * 0.25).tolist()),
            int((labels == number).sum()),
        )
        for number in range(1, count + 1)
    )
    centres = np.asarray((np.argwhere(cells) + 0.5) * 0.25, np.float64)
    found = changes_among(centres, np.zeros((0, 3)), 0.25, 0.25, 1)
    assert sorted((one.low_m, one.high_m, one.voxels) for one in found) == expected
    assert {one.kind for one in found} == {"appeared"}
    sizes = [one.voxels for one in found]
    assert sizes == sorted(sizes, reverse=True)
    large = changes_among(np.zeros((0, 3)), centres, 0.25, 0.25, 10)
    assert [one.voxels for one in large] == [size for size in sizes if size >= 10]


def test_changes_of_two_maps_are_both_kinds() -> None:
    wall = [(x, 0.125, 0.125) for x in np.arange(0.125, 5, 0.25)]
    box, rock = (2.125, 3.125, 0.125), (3.125, -3.125, 0.125)
    found = changes_of(compare_maps(map_of([*wall, rock], [box]), map_of([box], [*wall, rock])))
    assert [(one.kind, one.voxels) for one in found] == [
        ("vanished", 20),
        ("appeared", 1),
        ("vanished", 1),
    ]
    assert found[0].low_m == (0.0, 0.0, 0.0)
    assert found[0].high_m == (5.0, 0.25, 0.25)
