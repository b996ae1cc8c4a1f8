"""Our contenders and their comparison, on a ping small enough to reason about."""

import numpy as np
import pytest
from accuracy import Difference
from bench_pings import Pings
from our_contender import measure
from our_settings import config_of

from mapperd.mapping import SonarMap

UNCERTAIN_UP_TO = float(np.log(0.7 / 0.3))


def pings(count: int) -> Pings:
    """Pings of eight beams, 4 m, with one wall at 3 m, from one place."""
    images = np.zeros((count, 40, 8), dtype=np.uint8)
    images[:, 30] = 200
    poses = np.tile(np.eye(4), (count, 1, 1))
    return Pings(images, np.radians(np.linspace(-20.0, 20.0, 8)), 0.1, poses)


def map_of(points_m: list[list[float]], log_odds: list[float]) -> SonarMap:
    sonar_map = SonarMap(config_of("exact", 0.1))
    sonar_map.core.set_log_odds(np.array(points_m), np.array(log_odds))
    return sonar_map


def test_contender_counts_what_it_changed() -> None:
    run = measure(
        SonarMap(config_of("exact", 0.1)), pings(3), budget_s=60.0, first_returns_only=True
    )
    assert len(run.ms) == len(run.touched) == 3
    # One place, one scene: each ping changes all that is known.
    assert run.touched == [run.known_voxels] * 3
    assert run.memory_bytes > 0
    assert run.peak_rss_bytes >= run.start_rss_bytes > 1e6


def test_contender_begins_no_ping_when_its_time_is_up() -> None:
    run = measure(
        SonarMap(config_of("rays", 0.1)), pings(3), budget_s=0.0, first_returns_only=False
    )
    assert len(run.ms) == 1


def test_equal_maps_do_not_differ() -> None:
    difference = Difference(free_below=0.0, occupied_above=UNCERTAIN_UP_TO)
    one, other = (map_of([[0.05, 0.05, 0.05], [9.05, 0.05, 0.05]], [-2.0, 3.0]) for _ in range(2))
    difference.add(one, other)
    found = difference.result()
    assert (found.voxels, found.class_share, found.one_only_share) == (2, 0.0, 0.0)
    assert (found.mean, found.p95, found.mean_of_shared) == (0.0, 0.0, 0.0)


def test_differences_are_those_of_either_map_s_voxels() -> None:
    difference = Difference(free_below=0.0, occupied_above=UNCERTAIN_UP_TO)
    shared, mine, yours = [0.05, 0.05, 0.05], [-5.05, 0.05, 0.05], [5.05, 0.05, 0.05]
    one = map_of([shared, mine], [-2.0, 3.0])
    other = map_of([shared, yours], [-1.5, 0.25])
    difference.add(one, other)
    found = difference.result()
    assert found.voxels == 3
    assert found.one_only_share == pytest.approx(2 / 3)
    assert found.class_share == pytest.approx(2 / 3)  # both free where both know
    assert found.mean == pytest.approx((0.5 + 3.0 + 0.25) / 3, abs=1e-6)
    assert found.mean_of_shared == pytest.approx(0.5, abs=1e-6)
    assert found.p95 == pytest.approx(3.0, rel=0.02)


def test_classes_follow_the_thresholds() -> None:
    difference = Difference(free_below=0.0, occupied_above=UNCERTAIN_UP_TO)
    place = [[0.05, 0.05, 0.05]]
    difference.add(map_of(place, [-0.1]), map_of(place, [0.1]))  # free, uncertain
    difference.add(map_of(place, [0.8]), map_of(place, [0.9]))  # uncertain, occupied
    difference.add(map_of(place, [0.1]), map_of(place, [0.8]))  # both uncertain
    assert difference.result().class_share == pytest.approx(2 / 3)
