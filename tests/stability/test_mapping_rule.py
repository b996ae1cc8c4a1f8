"""Hard cases of the map's update rule, against fifty digits."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mpmath import mpf

from mapperd import _core
from mapperd.probability import log_odds_of, probabilities_of
from tests.stability.iwlo_oracle import UNIT, Rule, log_odds, sigmoid
from tests.stability.pings import Look

if TYPE_CHECKING:
    from numpy.typing import NDArray

HERE = np.full((1, 3), 0.5)
ALL = [i / 8 for i in range(-1016, 1017, 7)] + [-127.0, 127.0, -(2**-24), 0.0, 2**-24, 36.75]
"""Log-odds, all of them whole units."""


def core(rule: Rule) -> _core.IwloParams:
    return _core.IwloParams(**dataclasses.asdict(rule))


def one_voxel(rule: Rule) -> _core.VoxelMap:
    return _core.VoxelMap(1.0, core(rule))


def observe(
    voxels: _core.VoxelMap, occupied: NDArray[np.bool_], weights: NDArray[np.float64] | None = None
) -> None:
    points = np.repeat(HERE, len(occupied), axis=0)
    voxels.observe(points, np.where(occupied, 255.0, 0.0), occupied, weights)


def state(voxels: _core.VoxelMap) -> tuple[float, int]:
    """Log-odds without the rounding of a query to float32."""
    _, units, count = voxels.blocks()
    at = int(np.flatnonzero(count[0])[0])
    return float(units[0, at]) * float(UNIT), int(count[0, at])


def worst_of(rule: Rule, *, occupied: bool, counts: tuple[int, ...] = (0, 7, 1000)) -> float:
    """In units, over all log-odds and some counts; the rounding itself is half a unit."""
    params, worst = core(rule), mpf(0)
    for value in ALL:
        for count in counts:
            got, _ = params.update(value, count, occupied=occupied)
            worst = max(worst, abs(got - rule.after(value, count, occupied=occupied)) / UNIT)
    return float(worst)


WIDE = Rule(L_min=-127.0, L_max=127.0)


def test_a_free_step_is_exact_where_the_probability_rounds_to_one() -> None:
    """From log-odds 37 on p is 1 in a double, and 1 - p in the protection of what is occupied is 0.

    Naively 1 - p is divided by or its logarithm taken there, and the step is infinite or NaN.
    """
    assert sigmoid(mpf(37)) < 1
    assert 1 / (1 + math.exp(-37)) == 1
    for threshold in (0.5, 1.0, 0.01):
        rule = dataclasses.replace(WIDE, adaptive_threshold=threshold)
        assert worst_of(rule, occupied=False) <= 0.501


def test_an_occupied_step_is_exact_where_the_probability_vanishes() -> None:
    """At log-odds -127 p is 7e-56, and the published rule's step goes with it.

    Naively p is taken as 1 - (1 - p) in single precision: it is 0 from log-odds -17.4 on, and
    before that a step is off by two of the units that a voxel is held in.
    """
    for least in (0.25, 0.0):
        rule = dataclasses.replace(WIDE, adaptive_min_ratio=least)
        assert worst_of(rule, occupied=True) <= 0.501
    published = core(dataclasses.replace(WIDE, adaptive_min_ratio=0.0))
    assert published.update(-12.0, 0, occupied=True)[0] > -12.0


@pytest.mark.parametrize("threshold", [0.01, 0.5, 1.0])
def test_free_pings_taken_together_know_where_protection_begins(threshold: float) -> None:
    """Free steps below p = 1 - threshold are all alike and taken together; with 1 that is p = 0.

    Naively log(0 / 1) becomes the limit below which they are unscaled: minus infinity, as a whole
    number of units, is anything.
    """
    rule = dataclasses.replace(WIDE, adaptive_threshold=threshold)
    voxels = _core.VoxelMap(0.1, core(rule))
    look = Look(image=np.zeros((60, 33), np.float32), carve_no_return=True)
    expected = mpf(0)
    for count in range(30):
        look.into(voxels)
        expected = rule.after(float(expected), count, occupied=False)
    _, units, counts = voxels.blocks()
    seen = units[counts == 30]
    assert len(seen) > 1000
    assert seen.min() == seen.max()
    assert abs(int(seen[0]) - expected / UNIT) < 30


def test_a_sigmoid_of_any_sharpness_is_finite_and_rises() -> None:
    """At sharpness 10000 the sigmoid's exponential is of 5000, and a double ends at 709.

    Naively exp(x) / (1 + exp(x)) is infinity over infinity for bright echoes.
    """
    for sharpness in (0.0, 1e-300, 3.0, 1e4):
        rule = Rule(sharpness=sharpness)
        params = core(rule)
        at = np.linspace(35.0, 255.0, 301)[1:]
        got = np.array([params.occupied_weight(float(i)) for i in at])
        exact = np.array([float(rule.weight(float(i))) for i in at])
        assert np.abs(got - exact).max() < 1e-12
        assert (np.diff(got) >= 0).all()


@pytest.mark.parametrize("gap", [1e-8, 1e-6])
def test_a_threshold_just_below_full_scale_keeps_weights_between_0_and_1(gap: float) -> None:
    """Intensity over threshold is divided by a span that may be next to nothing.

    Naively the quotient of two cancelled differences lies outside of 0 to 1, and no clamp holds
    the weight.
    """
    rule = Rule(intensity_threshold=255.0 - gap)
    params = core(rule)
    for part in (0.1, 0.5, 1.0, 2.0):
        intensity = 255.0 - gap + part * gap
        assert params.occupied_weight(intensity) == pytest.approx(
            float(rule.weight(intensity)), abs=1e-6
        )


def test_a_voxel_hit_a_million_times_still_comes_free() -> None:
    """A quay that was mapped for days and is torn down must leave the map.

    Naively log-odds without a clamp stand at 286000 after a million hits, and three million pings
    of free water are needed before the map says so.
    """
    voxels = one_voxel(Rule())
    observe(voxels, np.ones(1_000_000, bool))
    assert state(voxels) == (10.0, 90)
    pings = 0
    while state(voxels)[0] > 0:
        observe(voxels, np.array([False]))
        pings += 1
    rule, expected, needed = Rule(), 10.0, 0
    while expected > 0:
        expected, needed = float(rule.after(expected, 90, occupied=False)), needed + 1
    assert pings == needed < 100


def test_a_voxel_seen_free_a_million_times_can_be_occupied() -> None:
    """A container that is put down in water seen free for days must show within a minute.

    Naively the occupied step falls with p to nothing, and 200000 pings are needed.
    """
    voxels = one_voxel(Rule())
    observe(voxels, np.zeros(1_000_000, bool))
    assert state(voxels) == (-10.0, 90)
    observe(voxels, np.ones(30, bool), np.full(30, 0.7))
    assert state(voxels)[0] > 0


def test_counts_stop_at_65535_and_do_not_begin_anew() -> None:
    """The slowest learning rate settles after 65535 pings, the last number of 16 bits.

    Naively the next ping makes the count 0, which means never observed: the voxel is gone and its
    learning rate is 1 again.
    """
    rule = Rule(decay_rate=1.0, min_alpha=1 / 65536, adaptive_update=False)
    voxels = one_voxel(rule)
    observe(voxels, np.arange(70_000) % 2 == 0)
    assert state(voxels)[1] == 65535
    before = state(voxels)[0]
    observe(voxels, np.array([True]))
    assert state(voxels)[0] - before == pytest.approx(3.5 * float(rule.weight(255.0)) / 65536, 1e-2)
    assert voxels.known_count() == 1


def test_a_million_tiny_steps_add_up_as_they_should() -> None:
    """A slow learner's steps are some thousandths, and a million of them make the map.

    Naively they are summed in single precision, which rounds each step beside 74 by up to 4e-6,
    often to one side: the sum is off by 0.18, six times what whole units may be off by.
    """
    rule = Rule(min_alpha=0.001, decay_rate=10.0, adaptive_update=False, L_min=-127.0, L_max=127.0)
    bright = float(rule.weight(255.0))
    factors = np.tile([1.0, 3.5 * bright / 3.0], 500_000)
    factors[1::2] *= np.random.default_rng(4).uniform(0.9, 1.0, 500_000)
    occupied = np.arange(1_000_000) % 2 == 0
    voxels = one_voxel(rule)
    observe(voxels, occupied, factors)
    alpha = np.maximum(0.001, 1 / (1 + 10.0 * np.arange(1_000_000)))
    steps = alpha * factors * np.where(occupied, 3.5 * bright, -3.0)
    exact = math.fsum(steps)
    assert 50 < exact < 126
    assert abs(state(voxels)[0] - exact) < 1_000_000 * UNIT / 2
    single = float(np.cumsum(steps.astype(np.float32), dtype=np.float32)[-1])
    assert abs(single - exact) > 5 * 1_000_000 * UNIT / 2


def test_clamps_of_127_hold_against_the_largest_steps() -> None:
    """Log-odds of 127 fill a whole number of 32 bits but for one part in 128.

    Naively the step is added to it in 32 bits: 127 and 3.5 is -125.5, and what was surely there is
    surely free.
    """
    rule = Rule(L_occ=127.0, L_free=-127.0, L_min=-127.0, L_max=127.0, adaptive_update=False)
    voxels = one_voxel(rule)
    observe(voxels, np.ones(3, bool))
    assert state(voxels)[0] == 127.0
    voxels.add_log_odds(HERE, np.array([1e300]), low=-1e300, high=1e300)
    assert state(voxels)[0] == 127.0
    observe(voxels, np.zeros(20, bool))
    assert state(voxels)[0] == -127.0
    voxels.add_log_odds(HERE, np.array([-1e300]), low=-1e300, high=1e300)
    assert state(voxels)[0] == -127.0


def test_maps_at_their_clamps_are_merged_inside_them() -> None:
    """Seven surveys, each sure of a wall, are sure together, and no count is beyond what settles.

    Naively their log-odds of 127 and counts of 65535 are added in the width that they are kept in.
    """
    rule = Rule(L_occ=127.0, L_min=-127.0, L_max=127.0, decay_rate=1.0, min_alpha=1 / 65536)
    maps = [one_voxel(rule) for _ in range(8)]
    for each in maps:
        observe(each, np.ones(66_000, bool))
    maps[0].merge(*maps[1:])
    assert state(maps[0]) == (127.0, 65535)


def test_probabilities_of_all_log_odds_are_those_of_fifty_digits() -> None:
    """Probabilities are shown down to the map's clamps, 1e-55.

    Naively p is 1 - 1 / (1 + exp(L)): 0 from L = -37 on, with digits lost long before.
    """
    values = np.array(ALL)
    got = probabilities_of(values)
    exact = [sigmoid(mpf(value)) for value in ALL]
    relative = [abs(mpf(float(a)) - b) / b for a, b in zip(got, exact, strict=True)]
    assert max(relative) < 1e-15 * 100
    assert (got > 0).all()


def test_log_odds_of_probabilities_beside_0_and_1_are_those_of_fifty_digits() -> None:
    """Thresholds may be set as near to 0 and 1 as a double goes.

    Naively the logarithm's argument is rounded to 0, or 1 - p to 1, and the threshold is infinite.
    """
    for p in (5e-324, 1e-300, 1e-16, 0.1, 0.5, 0.7, 1 - 2**-53, math.nextafter(0.5, 1)):
        assert abs(log_odds_of(p, "p") - log_odds(p)) <= 1e-15 * max(1, abs(log_odds(p)))
    for p in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="between 0 and 1"):
            log_odds_of(p, "p")


def test_probability_and_log_odds_are_each_other_s_way_back() -> None:
    """A map is told in probabilities and set in log-odds, by the same clients.

    Naively both ways lose as much as p has digits left below 1: at L = 20 that is 1e-7, and at 30 a
    thousandth.
    """
    values = np.linspace(-30, 30, 601)
    back = np.array([log_odds_of(float(p), "p") for p in probabilities_of(values)])
    # What p beside 1 can tell at all is half its last place times dL/dp = 1 / (p (1 - p)).
    can_tell = 2**-53 * (1 + np.exp(np.maximum(values, 0))) + 1e-14
    assert (np.abs(back - values) <= 3 * can_tell).all()
