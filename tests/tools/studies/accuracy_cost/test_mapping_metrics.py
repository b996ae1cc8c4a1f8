"""The figures of the study of mapping, on cases that can be worked out by hand."""

import math

import numpy as np
import pytest
from studies.accuracy_cost.mapping.measuring import mean_difference
from studies.accuracy_cost.mapping.metrics import (
    SolidBox,
    Solids,
    reliability,
    roc_area,
    sampled,
    surfaces,
)

PLANE = Solids((SolidBox((0.0, 0.0, -5.0), (100.0, 100.0, 10.0)),))
"""Its top is the plane z = 0."""


def grid(step_m: float, z_m: float) -> np.ndarray:
    across = np.arange(-0.95, 1.0, step_m)
    x, y = np.meshgrid(across, across)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z_m)], axis=1)


def test_a_map_a_known_way_off_a_plane() -> None:
    found = surfaces(PLANE, grid(0.1, 0.0), grid(0.1, 0.12), 0.1)
    assert found.accuracy_median_m == pytest.approx(0.12)
    assert found.accuracy_p95_m == pytest.approx(0.12)
    assert found.completeness_median_m == pytest.approx(0.12)
    assert found.completeness_p95_m == pytest.approx(0.12)
    assert found.error_m == pytest.approx(0.12)
    assert (found.complete_voxels, found.complete_fixed) == (1.0, 1.0)
    assert (found.f_one, found.f_two) == (0.0, 1.0)
    assert found.false_share == 0.0


def test_quantiles_are_those_of_distances_that_differ() -> None:
    far_m = np.arange(101) / 1000.0
    across = np.arange(101) * 0.01
    seen = np.stack([across, np.zeros(101), np.zeros(101)], axis=1)
    found = surfaces(PLANE, seen[:1], seen + np.outer(far_m, [0.0, 0.0, 1.0]), 0.1)
    assert (found.accuracy_median_m, found.accuracy_p95_m) == pytest.approx((0.050, 0.095))
    assert found.completeness_p95_m == 0.0
    found = surfaces(PLANE, seen, seen[:1], 0.1)
    assert (found.completeness_median_m, found.completeness_p95_m) == pytest.approx((0.50, 0.95))
    assert found.accuracy_p95_m == 0.0


def test_half_a_map_is_half_complete_and_wholly_right() -> None:
    centres = grid(0.1, 0.05)
    found = surfaces(PLANE, grid(0.1, 0.0), centres[centres[:, 0] < 0.0], 0.1)
    assert found.accuracy_p95_m == pytest.approx(0.05)
    assert found.complete_voxels == pytest.approx(0.55, abs=1e-9)  # one column more is near
    assert found.f_two == pytest.approx(2 * 0.55 / 1.55)


def test_false_surface_and_what_is_far_counts_once() -> None:
    centres = np.concatenate([grid(0.1, 0.05), grid(0.1, 40.0)])
    found = surfaces(PLANE, grid(0.1, 0.0), centres, 0.1)
    assert found.false_share == 0.5
    assert found.error_m == pytest.approx(((0.05 + 0.5) / 2 + 0.05) / 2)


def test_deep_in_a_solid_is_false_as_well() -> None:
    assert surfaces(PLANE, grid(0.1, 0.0), grid(0.1, -0.3), 0.1).false_share == 1.0


def test_nothing_mapped_is_the_largest_error() -> None:
    found = surfaces(PLANE, grid(0.1, 0.0), np.empty((0, 3)), 0.1)
    assert (found.error_m, found.complete_fixed) == (0.5, 0.0)
    assert math.isnan(found.accuracy_median_m)


def test_roc_area_is_the_share_of_pairs_in_order() -> None:
    random = np.random.default_rng(3)
    log_odds = np.round(random.normal(size=60), 1)
    solid = random.random(60) < 0.4
    pairs = log_odds[solid][:, None] - log_odds[~solid][None, :]
    by_hand = (np.count_nonzero(pairs > 0) + 0.5 * np.count_nonzero(pairs == 0)) / pairs.size
    assert roc_area(log_odds, solid) == pytest.approx(by_hand)
    assert math.isnan(roc_area(log_odds, np.ones(60, dtype=bool)))


def test_reliability_of_a_coin_and_of_a_liar() -> None:
    coin = reliability(np.zeros(1000), np.arange(1000) % 2 == 0)
    assert coin.counts.tolist() == [0, 0, 0, 0, 0, 1000, 0, 0, 0, 0]
    assert (coin.probability[5], coin.solid[5], coin.expected) == (0.5, 0.5, 0.0)
    log_odds = np.repeat([math.log(0.95 / 0.05), math.log(0.05 / 0.95)], [300, 100])
    liar = reliability(log_odds, np.repeat([False, True, False], [150, 200, 50]))
    assert liar.solid[9] == pytest.approx(0.5)
    assert liar.solid[0] == pytest.approx(0.5)
    assert liar.worst == pytest.approx(0.45)
    assert liar.expected == pytest.approx(0.45)


def test_a_bin_of_few_voxels_is_not_the_worst() -> None:
    log_odds = np.repeat([0.0, math.log(0.85 / 0.15)], [1000, 99])
    found = reliability(log_odds, np.arange(1099) % 2 == 0)
    assert found.worst == pytest.approx(0.0, abs=1e-3)
    assert found.expected > 0.03


def test_an_eighth_of_fine_voxels_is_looked_at_wherever_they_stand_in_the_map() -> None:
    place = np.stack(np.meshgrid(*[np.arange(-16, 16)] * 3), axis=-1).reshape(-1, 3)
    centres = np.asarray((place + 0.5) * 0.05, dtype=np.float64)
    chosen = sampled(centres, 0.05)
    assert len(chosen) == pytest.approx(len(centres) / 8, rel=0.05)
    mixed = np.random.default_rng(2).permutation(len(centres))
    again = mixed[sampled(centres[mixed], 0.05)]
    assert np.array_equal(np.sort(again), chosen)
    for axis in range(3):
        layers = np.bincount(place[chosen, axis] + 16, minlength=32)
        assert layers.min() > 80  # of 128: no layer is left out
    assert np.array_equal(sampled(centres, 0.1), np.arange(len(centres)))


def test_log_odds_differ_by_what_either_lacks_too() -> None:
    one = np.array([1, 5, 9]), np.array([1.0, -2.0, 3.0])
    other = np.array([5, 9, 12]), np.array([-1.0, 3.0, -4.0])
    assert mean_difference(one, other) == pytest.approx((1.0 + 1.0 + 0.0 + 4.0) / 4)
    assert mean_difference(one, one) == 0.0
