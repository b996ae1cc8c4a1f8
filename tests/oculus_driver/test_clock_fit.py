"""A sender's clock carried over to the host's."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.clock_fit import (
    BUCKET_NS,
    MAX_DRIFT,
    WINDOW_NS,
    ClockFit,
    _line_below,
    _StampPoints,
)

MS = 1_000_000
S = 1_000_000_000


def test_constant_delay_gives_arrival() -> None:
    clock = ClockFit()
    for k in range(10):
        assert clock.to_host_ns(k * S, 500 * S + k * S) == 500 * S + k * S


def test_late_records_keep_their_own_time() -> None:
    clock = ClockFit()
    assert clock.to_host_ns(0, 100 * S) == 100 * S
    assert clock.to_host_ns(S, 101 * S + 200 * MS) == 101 * S


def test_noise_of_delay_is_taken_out() -> None:
    rng = random.Random(1)  # noqa: S311 a test
    clock, errors = ClockFit(), []
    for k in range(600):
        stamp = k * 100 * MS
        delay = 2 * MS + round(rng.expovariate(1 / (6 * MS)))
        host = clock.to_host_ns(stamp, 1000 * S + stamp + delay)
        assert host is not None
        errors.append(host - (1000 * S + stamp))
    assert max(errors[50:]) < 4 * MS


@pytest.mark.parametrize("drift_ppm", [-100, -20, 0, 20, 100])
def test_drift_is_measured_and_taken_out(drift_ppm: int) -> None:
    rng = random.Random(2)  # noqa: S311 a test
    clock, errors = ClockFit(), []
    for k in range(1200):
        true_ns = 1000 * S + k * 100 * MS
        stamp_ns = 5 * S + round(k * 100 * MS * (1 - drift_ppm * 1e-6))
        delay_ns = round(rng.expovariate(1 / (2 * MS)))
        errors.append((clock.to_host_ns(stamp_ns, true_ns + delay_ns) or 0) - true_ns)
    assert clock.drift == pytest.approx(drift_ppm * 1e-6, abs=5e-6)
    assert max(map(abs, errors[200:])) < 100_000  # 0.1 ms; without the drift it is 0.4 ms
    assert clock.is_valid


def test_drift_is_not_guessed_from_a_few_late_records() -> None:
    clock = ClockFit()
    for k in range(4):
        assert clock.to_host_ns(k * 5 * S, 100 * S + k * 5 * S + k * 200 * MS) == (100 + 5 * k) * S
    assert clock.is_valid


def test_a_late_record_gets_the_offset_of_its_own_time() -> None:
    clock = ClockFit()
    for k in range(200):
        stamp_ns = round(k * 100 * MS * (1 - 200e-6))
        late_ns = 900 * MS if k == 199 else 0
        host_ns = clock.to_host_ns(stamp_ns, 1000 * S + k * 100 * MS + late_ns) or 0
    assert abs(host_ns - (1000 * S + 199 * 100 * MS)) < 1000  # of the arrival: 180 000


def test_a_prompt_record_counts_for_the_window_and_no_longer() -> None:
    for retry_delay_ns, lateness_ns in ((WINDOW_NS, 200 * MS), (WINDOW_NS + S, 0)):
        clock = ClockFit()
        clock.to_host_ns(0, 100 * S)
        arrival_ns = 100 * S + retry_delay_ns
        host_ns = clock.to_host_ns(retry_delay_ns - 200 * MS, arrival_ns)
        assert host_ns == pytest.approx(arrival_ns - lateness_ns, abs=retry_delay_ns * MAX_DRIFT)


def test_drift_is_not_guessed_from_a_short_time() -> None:
    clock = ClockFit()
    for k in range(20):
        clock.to_host_ns(k * 500 * MS, 100 * S + k * 501 * MS)
    assert clock.drift == 0.0


def test_a_lasting_change_of_delay_is_taken_up_within_the_window() -> None:
    clock, lateness_ns = ClockFit(), []
    for k in range(1200):
        arrival_ns = 1000 * S + k * 100 * MS + (5 * MS if k >= 600 else 0)
        lateness_ns.append(arrival_ns - (clock.to_host_ns(k * 100 * MS, arrival_ns) or 0))
        assert abs(clock.drift) <= MAX_DRIFT
    assert min(lateness_ns) >= 0
    assert max(lateness_ns) <= 5 * MS
    assert set(lateness_ns[:600] + lateness_ns[600 + WINDOW_NS // (100 * MS) :]) == {0}


@pytest.mark.parametrize("rate", [0.0, 0.5, 0.98, 1.02])
def test_stamps_that_do_not_run_like_a_clock_are_not_believed(rate: float) -> None:
    clock = ClockFit()
    for k in range(120):
        clock.to_host_ns(round(k * 100 * MS * rate), 1000 * S + k * 100 * MS)
    assert not clock.is_valid


def test_a_restart_that_is_known_costs_no_record() -> None:
    clock = ClockFit()
    for k in range(50, 55):
        clock.to_host_ns(k * S, (100 + k) * S)
    clock.restart()
    assert clock.to_host_ns(0, 160 * S) == 160 * S


def test_memory_and_fit_are_bounded_at_any_rate_and_order() -> None:
    rng = random.Random(3)  # noqa: S311 a test
    clock = ClockFit()
    for k in range(2_000):
        clock.to_host_ns(k, 10**18 + rng.randrange(-WINDOW_NS, WINDOW_NS))
    assert len(clock._points) <= 2 * WINDOW_NS // BUCKET_NS


points = st.lists(
    st.tuples(st.integers(0, 300), st.integers(-50, 50)),
    min_size=1,
    max_size=30,
    unique_by=lambda point: point[0],
).map(lambda some: sorted((10**18 + x * BUCKET_NS // 2, y * 1000) for x, y in some))


def points_of(some: list[tuple[int, int]]) -> _StampPoints:
    made = _StampPoints()
    for point in some:
        made.add(point)
    return made


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["add", "add", "add", "replace", "drop"]),
            st.integers(-3, 30),  # on from the last arrival; seldom back
            st.integers(-50, 50),
        ),
        max_size=60,
    )
)
def test_the_hull_is_the_same_however_the_points_came(steps: list[tuple[str, int, int]]) -> None:
    carried, plain, x = _StampPoints(), list[tuple[int, int]](), 0
    for step, on, y in steps:
        x += on
        if step == "drop" and len(plain) > 1:
            carried.drop_first()
            del plain[0]
        elif step == "replace" and plain:
            carried.replace_last((x, y))
            plain[-1] = (x, y)
        elif step == "add":
            carried.add((x, y))
            plain.append((x, y))
        if plain:
            assert carried.hull() == points_of(sorted(plain)).hull()


@given(points)
def test_no_line_below_all_points_is_closer_to_them(some: list[tuple[int, int]]) -> None:
    line = _line_below(points_of(some))
    above = [offset - line.at(arrival) for arrival, offset in some]
    assert min(above) >= -1  # whole nanoseconds
    if line.rate_error != line.slope or len(some) < 10 or some[-1][0] - some[0][0] < 10 * S:
        return
    for (x0, y0), (x1, y1) in itertools.combinations(some, 2):
        other = [y - y0 - (y1 - y0) * (x - x0) / (x1 - x0) for x, y in some]
        assert min(other) < -1e-3 or sum(above) <= sum(other) + len(some)


def test_one_stray_stamp_changes_nothing() -> None:
    clock = ClockFit()
    for k in range(5):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(10**18, 105 * S) is None
    assert clock.to_host_ns(6 * S, 106 * S) == 106 * S
    assert clock.to_host_ns(2 * S, 107 * S) is None
    assert clock.to_host_ns(8 * S, 108 * S) == 108 * S


def test_restart_of_the_sender_is_believed_at_its_second_record() -> None:
    clock = ClockFit()
    for k in range(50, 55):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(0, 160 * S) is None
    assert clock.to_host_ns(S, 161 * S) == 161 * S


def test_stall_does_not_move_the_clock() -> None:
    clock = ClockFit()
    for k in range(5):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(5 * S, 108 * S) == 105 * S
    assert clock.to_host_ns(6 * S, 108 * S) == 106 * S
    assert clock.to_host_ns(9 * S, 109 * S) == 109 * S
