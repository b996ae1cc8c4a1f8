import math
from typing import Any

import numpy as np
import pytest

from mapperd import ProbabilityUpdater
from mapperd.mapping.queries import OCCUPIED, UNKNOWN

HERE = [[0.01, 0.02, 0.03]]
UNIT = 2.0**-11  # of the log-odds that the map holds; every step is rounded to the nearest one


def near(expected: float, updates: int) -> Any:
    """Half a unit for each update, and the published vectors' last decimal."""
    return pytest.approx(expected, abs=updates * UNIT / 2 + 1e-6)


def log_odds(updater: ProbabilityUpdater) -> float:
    ((*_, probability),) = updater.get_occupied_voxels(0)
    return math.log(probability / (1 - probability))


def set_a() -> ProbabilityUpdater:
    """Set A of the reference's test vectors."""
    updater = ProbabilityUpdater()
    updater.set_iwlo_params(3.0, 0.1, 0.1, -10.0, 10.0)
    return updater


def test_published_vectors() -> None:
    updater = set_a()
    steps = [
        (145, 1.75),
        (145, 3.340909),
        (145, 4.799242),
        (255, 7.000404),
        (0, 6.354815),
        (0, 5.749956),
        (145, 6.843706),
        (145, 7.873118),
    ]
    for updates, (intensity, expected) in enumerate(steps, 1):
        updater.batch_update_iwlo(HERE, [intensity], [intensity > 0])
        assert log_odds(updater) == near(expected, updates)
    assert updater.get_observation_count((0, 0, 0)) == len(steps)
    assert updater.get_observation_count((1, 0, 0)) == 0


@pytest.mark.parametrize("weights", [[3, 2, 1], np.array([3.0, 2.0, 1.0])])
def test_published_vectors_with_weights(weights: Any) -> None:
    single = set_a()
    steps = ((145, 5.25), (0, 3.573774), (145, 5.032107))
    for updates, ((intensity, expected), weight) in enumerate(zip(steps, weights, strict=True), 1):
        single.batch_update_iwlo(HERE, [intensity], [intensity > 0], [weight])
        assert log_odds(single) == near(expected, updates)
    batch = set_a()
    batch.batch_update_iwlo(HERE * 3, [145, 0, 145], [True, False, True], weights)
    assert log_odds(batch) == log_odds(single)


def test_set_b_through_all_setters() -> None:
    updater = ProbabilityUpdater()
    updater.set_log_odds_params(2.0, -4.0)
    updater.set_iwlo_params(0.1, 0.1, 0.3, -12.0, 8.0)
    updater.set_adaptive_params(enable=True, threshold=0.5, max_ratio=0.3)
    updater.set_intensity_params(100.0, 255.0)
    for updates, expected in enumerate((0.991129, 1.892156, 2.718097), 1):
        updater.batch_update_iwlo(HERE, [150], [True])
        assert log_odds(updater) == near(expected, updates)


def pings_back(updater: ProbabilityUpdater, free_pings: int) -> int:
    """Pings at mid intensity until a voxel that was seen free is above 0.7."""
    updater.batch_update_iwlo(HERE * free_pings, [0] * free_pings, [False] * free_pings)
    for ping in range(1, 10_000):
        updater.batch_update_iwlo(HERE, [145], [True])
        if len(updater.get_occupied_voxels(0.7)):
            return ping
    raise AssertionError("never")


def test_changed_voxel_comes_back_within_30_pings() -> None:
    for free_pings, pings in ((1, 8), (2, 15), (5, 25), (1000, 28)):
        assert pings_back(set_a(), free_pings) == pings


def published_pings_back(free_pings: int, unit: float) -> int:
    """Of the original rule, with steps of whole units; 0 if a step has no effect."""
    value = 0.0
    for ping in range(free_pings + 10_000):
        p, alpha = 1 / (1 + math.exp(-value)), max(0.1, 1 / (1 + 0.1 * ping))
        if ping < free_pings:
            step = -3.0 * alpha
        else:
            step = 3.5 * 0.5 * alpha * (1.0 if p >= 0.5 else p / 0.5 * 0.3)
        if abs(step) < unit / 2:
            return 0
        value += round(step / unit) * unit
        if value > math.log(0.7 / 0.3):
            return ping + 1 - free_pings
    raise AssertionError("never")


def without_min_ratio() -> ProbabilityUpdater:
    updater = set_a()
    updater.set_adaptive_params(enable=True, threshold=0.5, max_ratio=0.3, min_ratio=0)
    return updater


@pytest.mark.parametrize(("free_pings", "published", "pings"), [(1, 84, 84), (2, 2850, 2877)])
def test_min_ratio_of_zero_is_the_published_rule(
    free_pings: int, published: int, pings: int
) -> None:
    assert published_pings_back(free_pings, 2.0**-40) == published
    assert published_pings_back(free_pings, UNIT) == pings
    assert pings_back(without_min_ratio(), free_pings) == pings


def test_without_min_ratio_steps_below_half_a_unit_are_invalid() -> None:
    assert published_pings_back(3, UNIT) == 0
    updater = without_min_ratio()
    updater.batch_update_iwlo(HERE * 3, [0] * 3, [False] * 3)
    free = log_odds(updater)
    assert free == near(-3 * (1 + 1 / 1.1 + 1 / 1.2), 3)
    updater.batch_update_iwlo(HERE * 10_000, [145] * 10_000, [True] * 10_000)
    assert log_odds(updater) == free
    assert updater.get_observation_count((0, 0, 0)) > 3


def test_adaptive_setter_without_min_ratio_takes_any_max_ratio() -> None:
    low, named = set_a(), set_a()
    low.set_adaptive_params(enable=True, threshold=0.5, max_ratio=0.1)
    named.set_adaptive_params(enable=True, threshold=0.5, max_ratio=0.1, min_ratio=0.1)
    assert pings_back(low, 5) == pings_back(named, 5) > pings_back(set_a(), 5)
    low.set_adaptive_params(enable=True, threshold=0.5, max_ratio=0.3)  # the default is back
    low.clear()
    assert pings_back(low, 5) == 25


def test_false_returns_in_free_water_flip_nothing() -> None:
    updater, generator = set_a(), np.random.default_rng(7)
    water = (np.stack(np.unravel_index(np.arange(4096), (16, 16, 16)), axis=1) + 0.5) * 0.05
    for rate in (0.0, 0.0, 1.0, 0.0, *[0.05] * 300):  # twice free, then a burst, then noise
        seen = generator.random(len(water)) < rate
        updater.batch_update_iwlo(water, 255.0 * seen, seen)
        assert len(updater.get_occupied_voxels(0.7)) == 0


def test_own_defaults() -> None:
    updater = ProbabilityUpdater()
    assert updater.get_resolution() == 0.05
    updater.batch_update_iwlo(HERE, [255], [True])
    assert log_odds(updater) == near(3.5 / (1 + math.exp(-0.05)), 1)


def test_flag_decides() -> None:
    updater = ProbabilityUpdater()
    updater.batch_update_iwlo(HERE, [200], [False])
    assert log_odds(updater) == pytest.approx(-3.0, abs=1e-5)
    dark = ProbabilityUpdater()
    dark.batch_update_iwlo(HERE, [10], [True])
    assert log_odds(dark) == 0.0
    assert dark.get_observation_count((0, 0, 0)) == 1


def test_empty_weights_are_no_weights() -> None:
    with_none, with_empty = ProbabilityUpdater(), ProbabilityUpdater()
    with_none.batch_update_iwlo(HERE, [100], [1])
    with_empty.batch_update_iwlo(HERE, [100], [1], [])
    assert log_odds(with_none) == log_odds(with_empty)


def test_clamps_are_one_pair_and_hold_at_once() -> None:
    updater = ProbabilityUpdater()
    updater.batch_update_iwlo(HERE * 40, [255] * 40, [True] * 40)
    assert log_odds(updater) == pytest.approx(10.0, abs=1e-4)
    updater.set_clamping_thresholds(0.1, 0.9)
    assert log_odds(updater) == near(math.log(9), 1)  # clamps are whole units too
    assert len(updater.get_occupied_voxels()) == 1  # and max_prob is no threshold
    updater.batch_update_iwlo(HERE * 40, [0] * 40, [False] * 40)
    assert log_odds(updater) == near(-math.log(9), 1)
    assert updater.get_observation_count([0, 0, 0]) > 1  # kept through the change of rule


def test_occupied_threshold_is_the_queries() -> None:
    updater = ProbabilityUpdater()
    updater.batch_update_iwlo(HERE, [100], [True])  # p = 0.85
    assert updater.queries.classify(HERE).tolist() == [OCCUPIED]
    updater.set_occupied_threshold(0.95)
    assert updater.queries.classify(HERE).tolist() == [UNKNOWN]
    with pytest.raises(ValueError, match="threshold"):
        updater.set_occupied_threshold(1.0)


@pytest.mark.parametrize(
    "arguments",
    [
        ([[0, 0, 0], [math.nan, 0, 0]], [1, 1], [True, True]),
        ([[0, 0, 0]], [math.nan], [True]),
        ([[0, 0, 0]], [-1.0], [True]),
        ([[0, 0, 0]], [1.0, 2.0], [True]),
        ([[0, 0, 0]], [1.0], [True, False]),
        ([[0, 0, 0]], [1.0], [0.5]),
        ([[0, 0, 0]], [1.0], [True], [-1.0]),
        ([[0, 0, 0]], [1.0], [True], [math.inf]),
        ([[0, 0, 0]], [1.0], [True], [1.0, 1.0]),
        ([[0, 0]], [1.0], [True]),
    ],
)
def test_bad_batches_change_nothing(arguments: tuple[Any, ...]) -> None:
    updater = ProbabilityUpdater()
    with pytest.raises(ValueError, match=r"\w"):
        updater.batch_update_iwlo(*arguments)
    assert updater.get_num_nodes() == 0


@pytest.mark.parametrize(
    ("setter", "arguments"),
    [
        ("set_log_odds_params", (-1.0, -3.0)),
        ("set_adaptive_params", (False, 0.0, 0.3)),
        ("set_adaptive_params", (True, 0.5, 0.3, 0.4)),
        ("set_adaptive_params", (True, 0.5, math.nan)),
        ("set_clamping_thresholds", (0.6, 0.9)),
        ("set_clamping_thresholds", (0.0, 1.0)),
        ("set_iwlo_params", (3.0, 0.1, 0.0, -10.0, 10.0)),
        ("set_intensity_params", (math.nan, 255.0)),
    ],
)
def test_bad_parameters_change_nothing(setter: str, arguments: tuple[Any, ...]) -> None:
    updater, reference = ProbabilityUpdater(), ProbabilityUpdater()
    with pytest.raises(ValueError, match=r"\w"):
        getattr(updater, setter)(*arguments)
    for one in (updater, reference):
        one.batch_update_iwlo(HERE * 3, [0, 150, 200], [False, True, True])
    assert log_odds(updater) == log_odds(reference)


@pytest.mark.parametrize("key", [(0, 0), (0.5, 0, 0), "0_0_0"])
def test_bad_keys_are_refused(key: Any) -> None:
    with pytest.raises(ValueError, match="three whole numbers"):
        ProbabilityUpdater().get_observation_count(key)


def test_the_rest_of_the_published_names() -> None:
    updater = ProbabilityUpdater(0.1)
    updater.batch_update_iwlo([[0, 0, 0], [1, 1, 1]], [100, 0], [True, False])
    updater.set_incremental_sync(False)
    updater.force_full_sync()
    assert updater.get_occupied_voxels()[0, :3] == pytest.approx([0.05, 0.05, 0.05])
    assert updater.get_memory_usage().num_leaf_nodes == 2
    assert updater.prune_tree() == 0
    updater.clear()
    assert updater.get_num_nodes() == 0
