"""Hard cases of the map's update rule, against fifty digits."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mpmath import mpf

from mapperd import _core
from mapperd.mapping.probability import log_odds_of, probabilities_of
from tests.stability.iwlo_oracle import UNIT, Rule, WholeRule, log_odds, sigmoid
from tests.stability.pings import Look, at, empty, fan

if TYPE_CHECKING:
    from numpy.typing import NDArray

HERE = np.full((1, 3), 0.5)
ALL = [i / 8 for i in range(-1016, 1017, 7)] + [-127.0, 127.0, -(2**-24), 0.0, 2**-24, 36.75]
"""Log-odds, all of them whole numbers of 2^-24."""


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


@pytest.mark.slow
def test_a_free_step_is_exact_where_the_probability_rounds_to_one() -> None:
    """From log-odds 37 on p is 1 in a double, and 1 - p in the protection of what is occupied is 0.

    Naively 1 - p is divided by or its logarithm taken there, and the step is infinite or NaN.
    """
    assert sigmoid(mpf(37)) < 1
    assert 1 / (1 + math.exp(-37)) == 1
    for threshold in (0.5, 1.0, 0.01):
        rule = dataclasses.replace(WIDE, adaptive_threshold=threshold)
        assert worst_of(rule, occupied=False) <= 0.501


@pytest.mark.slow
def test_an_occupied_step_is_exact_where_the_probability_vanishes() -> None:
    """At log-odds -127 p is 7e-56, and the original rule's step goes with it.

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
    voxels, whole = _core.VoxelMap(0.1, core(rule)), WholeRule(rule)
    look = Look(image=np.zeros((60, 33), np.float32), carve_no_return=True)
    units, count, worst = 0, 0, mpf(0)
    for _ in range(30):
        look.into(voxels)
        exact = rule.after(units * whole.unit, count, occupied=False) / whole.unit
        units, count = whole.after_ping(units, count)
        worst = max(worst, abs(units - exact))
    _, held, counts = voxels.blocks()
    seen = held[counts == 30]
    assert len(seen) > 1000
    assert (seen * float(UNIT) == units * whole.unit).all()
    # Two products are rounded to half a unit each; their factors, 1 among them, to 2^-15 of 768.
    assert worst < 1 + 2 * 768 * 2**-15


@pytest.mark.parametrize(
    "rule",
    [
        Rule(),
        WIDE,
        Rule(adaptive_update=False),
        Rule(adaptive_threshold=0.8, adaptive_max_ratio=0.9, adaptive_min_ratio=0.0),
        Rule(decay_rate=0.01, min_alpha=0.01, protect_occupied=False),
        Rule(L_occ=0.3, L_free=-0.2, L_min=-2.0, L_max=31.0),
    ],
    ids=["usual", "wide", "plain", "published", "slow", "small"],
)
def test_a_series_of_pings_is_the_rule_in_whole_numbers(rule: Rule) -> None:
    """A voxel's steps are whole units that depend on its state alone: 2000 pings have one sum.

    Naively steps are products of floats, which a vector unit, a table and the free pings that are
    taken together round otherwise: the map depends on the machine.
    """
    rng = np.random.default_rng(11)
    voxels, whole = empty(0.1, **dataclasses.asdict(rule)), WholeRule(rule)
    here, units, count = np.array([[1.55, 0.05, 0.05]]), 0, 0
    white, black = np.full((20, 9), 255, np.float32), np.zeros((20, 9), np.float32)
    look = Look(bearings_rad=fan(9, 0.3), row_m=0.1, pose=at(0.05, 0.05, 0.05))
    for number in range(2000):
        # Long runs of either kind reach the clamps, and are kept pending.
        occupied = bool(rng.uniform() < (0.3, 0.02, 0.98, 0.5)[number // 50 % 4])
        look.but(image=white if occupied else black, carve_no_return=True).into(voxels)
        units, count = whole.after_ping(units, count, 255 if occupied else None)
        if number % 37 == 0 or number > 1900:
            held, seen = voxels.query(here)[:2]
            assert (float(held[0]), int(seen[0])) == (units * whole.unit, count)


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
    of free water are needed before the map shows it.
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


def test_counts_stop_at_65535_and_do_not_start_again() -> None:
    """The slowest learning rate settles after 65535 pings, the last number of 16 bits.

    Naively the next ping makes the count 0, which means never observed: the voxel is gone and its
    learning rate is 1 again.
    """
    rule = Rule(decay_rate=1.0, min_alpha=1 / 65536, adaptive_update=False)
    voxels = one_voxel(rule)
    observe(voxels, np.arange(70_000) % 2 == 0)
    assert state(voxels)[1] == 65535
    before, unit = state(voxels)[0], WholeRule(rule).unit
    observe(voxels, np.array([True]))
    step = 3.5 * float(rule.weight(255.0)) / 65536
    assert step < unit / 2
    assert state(voxels) == (before, 65535)  # a step of less than half a unit is 0
    # Its rate shows in one that counts 65536 times; at a rate of 1 it would end at the clamp.
    observe(voxels, np.array([True]), np.array([65536.0]))
    assert abs(state(voxels)[0] - before - 65536 * step) <= unit / 2
    assert state(voxels)[0] < 10.0
    assert voxels.known_count() == 1


def test_a_million_tiny_steps_add_up_in_whole_units() -> None:
    """A million steps about as large as a unit are rounded each to a whole one: half a unit is lost
    at each at most, the sum of what is left is exact, and the same in any order.

    Naively they are summed in single precision, which rounds the sum at each step: it is
    nearer to the rule, but in another order it is another map.
    """
    rule = Rule(decay_rate=0.0, adaptive_update=False, L_min=-15.0, L_max=15.0)
    bright, whole = 3.5 * float(rule.weight(255.0)), WholeRule(rule)
    occupied = np.arange(1_000_000) % 2 == 0
    wanted = np.random.default_rng(4).uniform(0.5, 3.5, 1_000_000) * whole.unit
    factors = wanted / np.where(occupied, bright, 3.0)
    steps = factors * np.where(occupied, bright, -3.0)
    rounded = np.round(steps / whole.unit)
    sums = np.cumsum(rounded) * whole.unit
    assert np.abs([sums, sums[-1] - sums]).max() < 15  # no clamp comes between, either way
    singles = []
    for turn in (slice(None), slice(None, None, -1)):
        voxels = one_voxel(rule)
        observe(voxels, occupied[turn].copy(), factors[turn].copy())
        assert state(voxels) == (sums[-1], 1)
        singles.append(np.cumsum(steps[turn].astype(np.float32), dtype=np.float32)[-1])
    assert abs(sums[-1] - math.fsum(steps)) <= 1_000_000 * whole.unit / 2
    assert singles[0] != singles[1]


@pytest.mark.slow
def test_a_slow_learner_s_steps_are_whole_units_and_its_sum_is_theirs() -> None:
    """A learning rate of a thousandth makes steps of less than a unit, each of which is a whole one
    or 0: the map holds exactly their sum, which after a million is 3 where the rule gives 74.

    Naively steps are cut off to whole units: those of seven tenths are 0, and a voxel stands
    still whatever is seen.
    """
    rule = Rule(min_alpha=0.001, decay_rate=10.0, adaptive_update=False, L_min=-127.0, L_max=127.0)
    bright, whole = float(rule.weight(255.0)), WholeRule(rule)
    factors = np.tile([1.0, 3.5 * bright / 3.0], 500_000)
    factors[1::2] *= np.random.default_rng(4).uniform(0.9, 1.0, 500_000)
    occupied = np.arange(1_000_000) % 2 == 0
    voxels = one_voxel(rule)
    observe(voxels, occupied, factors)
    units, count = 0, 0
    for is_occupied, factor in zip(occupied.tolist(), factors.tolist(), strict=True):
        units, count = whole.after_point(units, count, occupied=is_occupied, factor=factor)
    assert state(voxels) == (units * whole.unit, count)
    alpha = np.maximum(0.001, 1 / (1 + 10.0 * np.arange(1_000_000)))
    exact = math.fsum(alpha * factors * np.where(occupied, 3.5 * bright, -3.0))
    assert abs(state(voxels)[0] - exact) <= 1_000_000 * whole.unit / 2
    # 0.73 of a unit up and 0.66 or more down are a whole one each.
    assert (round(state(voxels)[0]), round(exact)) == (3, 74)


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
    """The same clients read a map as probabilities and set it as log-odds.

    Naively both ways lose as much as p has digits left below 1: at L = 20 that is 1e-7, and at 30 a
    thousandth.
    """
    values = np.linspace(-30, 30, 601)
    back = np.array([log_odds_of(float(p), "p") for p in probabilities_of(values)])
    # What p beside 1 can resolve at all is half its last place times dL/dp = 1 / (p (1 - p)).
    resolved = 2**-53 * (1 + np.exp(np.maximum(values, 0))) + 1e-14
    assert (np.abs(back - values) <= 3 * resolved).all()
