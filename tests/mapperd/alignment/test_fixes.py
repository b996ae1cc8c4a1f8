"""Alignment by position fixes alone: a long drifting line without sonar data."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.alignment.align import Alignment, DiveInput, _DiveNodes, align, odometry_steps
from mapperd.alignment.pose_graph import OdometryStep
from mapperd.alignment.submaps import DiveSubmaps, OdometryTrack, compose, inverse
from mapperd.errors import ReplayError

Floats = NDArray[np.float64]

COUNT = 1050
"""At 1 m/s and 2.5 records a second: 420 m."""

SITE_T_LINE = np.array([100.0, 200.0, 0.7])
T_NS = np.arange(COUNT, dtype=np.int64) * 400_000_000


def line() -> Floats:
    return np.column_stack([0.4 * np.arange(COUNT), np.zeros((COUNT, 2))])


def drifting(truth: Floats) -> Floats:
    """4 % too long, 0.02 rad aside, turning by two degrees a minute."""
    turn = math.radians(2.0) / 60 * 0.4
    odometry = [truth[0]]
    for a, b in itertools.pairwise(truth):
        x, y, yaw = compose(inverse(a), b)
        step = np.array([1.04 * x - 0.02 * y, 0.02 * x + 1.04 * y, yaw + turn])
        odometry.append(compose(odometry[-1], step))
    return np.array(odometry)


def track_of(odometry: Floats, deviation_m: Floats | None = None) -> OdometryTrack:
    half = odometry[:, 2] / 2
    zero = np.zeros(COUNT)
    return OdometryTrack(
        T_NS,
        np.column_stack([odometry[:, :2], zero]),
        np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
        np.zeros(COUNT, dtype=np.int64),
        zero if deviation_m is None else deviation_m,
    )


def known() -> Floats:
    return compose(np.broadcast_to(SITE_T_LINE, (COUNT, 3)), line())


def fixes_at(
    shares: tuple[float, ...], deviation_m: float
) -> list[tuple[int, float, float, float]]:
    rows = [round(share * (COUNT - 1)) for share in shares]
    return [(int(T_NS[k]), *known()[k, :2].tolist(), deviation_m) for k in rows]


def aligned(
    fixes: list[tuple[int, float, float, float]], odometry: Floats, name: str = "dive"
) -> Alignment:
    return align([given(fixes, odometry, name)])


def given(fixes: list[tuple[int, float, float, float]], odometry: Floats, name: str) -> DiveInput:
    track = track_of(odometry)
    return DiveInput(name, lambda _: DiveSubmaps(track, [], []), fixes=tuple(fixes))


def rms_m(a: Floats, b: Floats) -> float:
    return float(np.sqrt(((a - b)[:, :2] ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("deviation_m", [0.02, 0.3, 1.0])
def test_fixes_bend_a_long_line_whatever_their_deviation(deviation_m: float) -> None:
    odometry = drifting(line())
    found = aligned(fixes_at((0.0, 0.3, 0.6, 0.8, 1.0), deviation_m), odometry)
    assert found.corrected, found.reason
    drift_m = rms_m(odometry, line())
    assert rms_m(found.dives[0].poses_at(T_NS), known()) < 0.05 * drift_m
    assert found.figures["fixes_accepted"] == 5


def test_the_frame_of_the_fixes_has_their_heading() -> None:
    own_T_line = np.array([-30.0, 5.0, 1.1])  # noqa: N806 frames
    odometry = compose(np.broadcast_to(own_T_line, (COUNT, 3)), line())
    dive = given(fixes_at((0.0, 0.4, 1.0), 0.3), odometry, "dive")
    frame, has_heading = _DiveNodes.of(dive, dive.read(None)).frame_by_fixes()
    assert has_heading
    assert frame == pytest.approx(compose(SITE_T_LINE, inverse(own_T_line)), abs=1e-6)


def test_a_wrong_fix_is_refused() -> None:
    fixes = fixes_at((0.0, 0.2, 0.4, 0.6, 0.8, 1.0), 0.3)
    fixes.append((int(T_NS[500]), 900.0, -300.0, 0.3))
    found = aligned(fixes, drifting(line()))
    assert found.corrected
    assert found.figures["fixes_accepted"] == 6
    assert found.figures["fixes_unreachable"] == 1
    assert rms_m(found.dives[0].poses_at(T_NS), known()) < 2.0


@pytest.mark.parametrize("shares", [(), (0.0, 0.2, 0.4, 0.6, 0.9, 1.0)])
def test_no_fix_is_unreachable_unless_it_is_wrong(shares: tuple[float, ...]) -> None:
    assert "fixes_unreachable" not in aligned(fixes_at(shares, 0.3), drifting(line())).figures
    wrong = [*fixes_at(shares, 0.3), (int(T_NS[500]), 900.0, -300.0, 0.3)]
    if shares:
        assert aligned(wrong, drifting(line())).figures["fixes_unreachable"] == 1


def test_good_odometry_is_placed_as_it_is() -> None:
    found = aligned(fixes_at((0.0, 0.3, 0.6, 1.0), 0.3), line())
    assert found.corrected
    assert rms_m(found.dives[0].poses_at(T_NS), known()) < 0.05


@pytest.mark.parametrize("shares", [(0.5,), (0.0, 0.002, 0.004)])
def test_fixes_at_one_place_correct_nothing_and_leave_the_frame(shares: tuple[float, ...]) -> None:
    odometry = drifting(line())
    found = aligned(fixes_at(shares, 0.3), odometry)
    assert not found.corrected
    assert rms_m(found.dives[0].poses_at(T_NS), odometry) < 1e-6
    # The heading is the odometry's: no fix tells it. Uncertainty counts from the first pose.
    assert found.figures["deviation_m"] < 1.1 * found.figures["odometry_deviation_m"]


def test_the_covariance_of_what_was_refused_is_that_of_the_odometry() -> None:
    odometry = drifting(line())
    alone, fixed = (aligned(some, odometry) for some in ([], fixes_at((0.0, 1.0), 0.3)))
    assert not fixed.corrected
    last = (one.dives[0].covariance[-1, :2, :2].trace() for one in (alone, fixed))
    assert next(last) == pytest.approx(next(last), rel=1e-3)


def test_fixes_of_another_time_are_an_error() -> None:
    fixes = [(int(T_NS[-1]) + 10**12, 1.0, 2.0, 1.0)]
    with pytest.raises(ReplayError, match="within the dive"):
        aligned(fixes, line())


def test_dives_with_fixes_of_their_own_share_the_frame_of_the_fixes() -> None:
    shares = (0.0, 0.3, 0.6, 0.8, 1.0)
    turned = compose(np.broadcast_to(np.array([-30.0, 5.0, 2.0]), (COUNT, 3)), drifting(line()))
    dives = [
        given(fixes_at(shares, 0.3), drifting(line()), "one"),
        given(fixes_at(shares, 0.3), turned, "two"),
    ]
    found = align(dives)
    assert found.corrected, found.reason
    for dive in found.dives:
        assert rms_m(dive.poses_at(T_NS), known()) < 1.0


def test_a_dive_that_nothing_joins_to_the_fixed_one_is_refused() -> None:
    dives = [
        given([], drifting(line()), "loose"),
        given(fixes_at((0.0, 0.3, 0.6, 1.0), 0.3), drifting(line()), "fixed"),
    ]
    found = align(dives)
    assert not found.corrected
    assert "loose" in found.reason


@pytest.mark.parametrize("before_m", [0.0, 3.0, 8.0])
def test_missing_velocity_counts_whatever_was_unsure_before(before_m: float) -> None:
    # Variances add: an outage of 2 m late in a dive adds little to the standard deviation.
    grown = np.where(np.arange(COUNT) > 500, math.hypot(before_m, 2.0), before_m)
    _, step = odometry_steps(track_of(line(), grown), T_NS[[490, 510]])
    assert step is not None
    assert step.outage_std_m == pytest.approx(2.0 / math.sqrt(2))  # of each axis


@pytest.mark.parametrize("before_m", [0.0, 3.0])
def test_deviations_of_one_outage_add_up_over_its_steps(before_m: float) -> None:
    # 0.3 m/s in 12 s of 20, then sure; one velocity that is off grows the deviation linearly.
    since_s = np.clip((T_NS - T_NS[300]) / 1e9, 0.0, 12.0)
    track = track_of(line(), np.hypot(before_m, 0.3 * since_s))
    steps = odometry_steps(track, T_NS[300 + 6 * np.arange(-2, 7)])  # 2.4 s each
    outage_std_m = [step.outage_std_m for step in steps if step is not None]
    # Beside 3 m it is noticed a little late.
    assert outage_std_m[3:6] == pytest.approx([2.4 * 0.3 / math.sqrt(2)] * 3, rel=0.2)
    assert sum(outage_std_m[2:7]) == pytest.approx(12.0 * 0.3 / math.sqrt(2), rel=0.01)
    assert outage_std_m[0] == outage_std_m[1] == outage_std_m[7] == 0.0


def lost_of(deviation_m: Floats, every: int) -> list[OdometryStep]:
    steps = odometry_steps(track_of(line(), deviation_m), T_NS[::every])
    return [step for step in steps if step is not None]


def test_a_long_outage_is_several_ones() -> None:
    # 0.3 m/s for 100 s: its error stays alike for half a minute.
    since_s = np.clip((T_NS - T_NS[100]) / 1e9, 0.0, 100.0)
    steps = [step for step in lost_of(0.3 * since_s, 5) if step.outage_std_m > 0]
    outages = [step.outage for step in steps]
    assert outages == sorted(outages, key=lambda one: one or 0)
    sums_m = [
        sum(s.outage_std_m for s in steps if s.outage == one) for one in dict.fromkeys(outages)
    ]
    assert len(sums_m) == 4  # of 25 s
    # Variances add up to what was stated.
    assert math.hypot(*sums_m) == pytest.approx(30.0 / math.sqrt(2), rel=0.1)


@pytest.mark.parametrize("every", [1, 2, 6, 50])
def test_an_outage_is_the_same_however_close_the_nodes_are(every: int) -> None:
    # Stated every two seconds, so that the deviation rises in steps.
    since_s = np.clip((T_NS - T_NS[300]) / 1e9, 0.0, 20.0)
    steps = lost_of(np.hypot(1.0, 0.3 * since_s // 0.6 * 0.6), every)
    lost = [step for step in steps if step.outage_std_m > 0]
    assert len({step.outage for step in lost}) == 1
    assert sum(step.outage_std_m for step in lost) == pytest.approx(6.0 / math.sqrt(2))


def test_what_odometry_usually_states_is_no_outage() -> None:
    path_m = line()[:, 0]
    rng = np.random.default_rng(5)
    usual: list[Floats] = [
        np.full(COUNT, 2.0),
        0.5 + 0.015 * path_m,
        np.hypot(0.1, 0.1 * np.sqrt(path_m)),
        np.linspace(5.0, 1.0, COUNT),
        np.where(np.arange(COUNT) % 100 < 50, 1.0, 0.2),  # falls at fixes, and rises at once
        2.0 + 0.005 * rng.standard_normal(COUNT),
    ]
    for usual_m in usual:
        stated = [step.outage_std_m for step in lost_of(usual_m, 6)]
        rises = np.diff(usual_m).max() > 0.5
        assert sum(one > 0 for one in stated) <= (10 if rises else 0)


def test_a_jump_ends_an_outage() -> None:
    since_s = np.clip((T_NS - T_NS[300]) / 1e9, 0.0, 20.0)
    segment = (np.arange(COUNT) >= 325).astype(np.int64)
    track = replace(track_of(line(), 0.3 * since_s), segment=segment)
    steps = [step for step in odometry_steps(track, T_NS[::5]) if step is not None]
    jumps = [step for step in steps if step.extra_std_m > 0]
    assert [step.outage for step in jumps] == [None]
    assert len({step.outage for step in steps if step.outage_std_m > 0}) == 2


def test_dives_of_one_name_are_refused() -> None:
    given = DiveInput("a", lambda _: pytest.fail("nothing is read"))
    with pytest.raises(ReplayError, match="same name"):
        align([given, given])
