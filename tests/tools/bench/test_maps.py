"""Our contenders and the comparison of details, on a ping small enough to reason about."""

import numpy as np
import pytest
from bench.detail import ClassDifference
from bench.inputs import Pings
from bench.our_contender import ContenderRun, config_of

from mapperd.mapping.sonar_map import SonarMap

UNCERTAIN_UP_TO = float(np.log(0.7 / 0.3))


def pings(count: int) -> Pings:
    """Pings of eight beams, 4 m, with one wall at 3 m, from one place."""
    images = np.zeros((count, 40, 8), dtype=np.uint8)
    images[:, 30] = 200
    poses = np.tile(np.eye(4), (count, 1, 1))
    return Pings(images, np.radians(np.linspace(-20.0, 20.0, 8)), 0.1, poses)


def run_of(way: str, count: int, budget_s: float = 60.0) -> ContenderRun:
    return ContenderRun(config_of(way, 0.1), pings(count), budget_s, first_returns_only=True)


def map_of(points_m: list[list[float]], log_odds: list[float]) -> SonarMap:
    sonar_map = SonarMap(config_of("grid", 0.1))
    sonar_map.core.set_log_odds(np.array(points_m), np.array(log_odds))
    return sonar_map


def difference_of(one: SonarMap, other: SonarMap) -> ClassDifference:
    difference = ClassDifference(free_below=0.0, occupied_above=UNCERTAIN_UP_TO)
    difference.add(one, other)
    return difference


def test_contender_counts_what_it_changed() -> None:
    run = run_of("grid", 3).measure()
    assert len(run.ms) == len(run.second_ms) == len(run.touched) == 3
    # One place, one scene: each ping changes all that is known.
    assert run.touched == [run.known_voxels] * 3
    assert run.memory_bytes > 0
    assert run.held_voxels > 0
    assert run.peak_rss_bytes >= run.start_rss_bytes > 1e6
    assert run.motion_ratio is None


def test_contender_times_each_ping_at_rest_and_moving() -> None:
    run = run_of("grid", 3).measure(with_motion=True)
    assert len(run.resting_ms) == len(run.moving_ms) == 3
    assert run.motion_ratio is not None


@pytest.mark.parametrize("way", ["grid", "rays"])
def test_contender_begins_no_ping_when_the_budget_is_used_up(way: str) -> None:
    run = run_of(way, 3, budget_s=0.0).measure(with_motion=True)
    assert [len(ms) for ms in (run.ms, run.second_ms, run.resting_ms, run.moving_ms)] == [1] * 4


def test_equal_maps_do_not_differ() -> None:
    one, other = (map_of([[0.05, 0.05, 0.05], [9.05, 0.05, 0.05]], [-2.0, 3.0]) for _ in range(2))
    found = difference_of(one, other).result()
    assert (found.pings, found.voxels) == (1, 2)
    assert (found.class_share, found.one_only_share, found.mean) == (0.0, 0.0, 0.0)


def test_differences_are_those_of_either_map_s_voxels() -> None:
    shared, mine, yours = [0.05, 0.05, 0.05], [-5.05, 0.05, 0.05], [5.05, 0.05, 0.05]
    found = difference_of(
        map_of([shared, mine], [-2.0, 3.0]), map_of([shared, yours], [-1.5, 0.25])
    ).result()
    assert found.voxels == 3
    assert found.one_only_share == pytest.approx(2 / 3)
    assert found.class_share == pytest.approx(2 / 3)  # both free where both know
    # The new map stores log-odds in coarser units than a float's.
    assert found.mean == pytest.approx((0.5 + 3.0 + 0.25) / 3, abs=2e-3)


def test_classes_follow_the_thresholds() -> None:
    place = [[0.05, 0.05, 0.05]]
    difference = difference_of(map_of(place, [-0.1]), map_of(place, [0.1]))  # free, uncertain
    difference.add(map_of(place, [0.8]), map_of(place, [0.9]))  # uncertain, occupied
    difference.add(map_of(place, [0.1]), map_of(place, [0.8]))  # both uncertain
    assert difference.result().class_share == pytest.approx(2 / 3)
