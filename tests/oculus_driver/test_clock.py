"""Times of pings and rows, on the host's clock."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oculus_driver import Message, Ping, PingTime, SonarClock, decode_ping, row_times_ns

if TYPE_CHECKING:
    from collections.abc import Iterable

MakePing = Callable[..., bytes]
Parse = Callable[[bytes], Message]
Pings = Callable[..., Ping]

MS = 1_000_000
S = 1_000_000_000
BOOT_NS = 10**18
"""Power-up of the sonar, on the host's clock."""


@pytest.fixture(scope="module")
def ping_at(make_ping: MakePing, parse: Parse) -> Pings:
    """Return a maker of pings that look 50 rows · 0.3 m far: 20 ms there and back."""
    base = decode_ping(parse(make_ping(rows=50, range_resolution_m=0.3)))
    assert isinstance(base, Ping)

    def make(ping_id: int, start_s: float | None, arrival_ns: int | None, **changes: Any) -> Ping:
        changes |= {"ping_id": ping_id, "start_time_s": start_s, "arrival_ns": arrival_ns}
        return replace(base, **changes)

    return make


def placed(clock: SonarClock, pings: Iterable[Ping]) -> list[PingTime]:
    times = [clock.place(ping) for ping in pings]
    return [time for time in times if time is not None]


def arrival(start_s: float, delay_ns: int = 0, flight_ns: int = 20 * MS) -> int:
    return BOOT_NS + round(start_s * 1e9) + flight_ns + delay_ns


def test_a_prompt_ping_left_when_its_clock_has_it(ping_at: Pings) -> None:
    time = SonarClock().place(ping_at(1, 5.0, arrival(5.0)))
    assert time == PingTime(1, BOOT_NS + 5 * S, BOOT_NS + 5 * S + 20 * MS, 0, "device")


def test_the_delay_of_network_and_host_is_taken_out(ping_at: Pings) -> None:
    rng = random.Random(1)  # noqa: S311 a test
    clock = SonarClock()
    delays = [round(rng.expovariate(1 / (5 * MS))) for _ in range(600)]
    pings = [ping_at(k, k / 10 + 1, arrival(k / 10 + 1, delay)) for k, delay in enumerate(delays)]
    late = [
        time.transmit_ns - (BOOT_NS + S + k * S // 10)
        for k, time in enumerate(placed(clock, pings))
    ]
    assert max(map(abs, late[100:])) < 300_000
    assert max(delays[100:]) > 20 * MS  # what the arrivals alone would have made of it
    assert clock.placed == {"device": 600}


def test_lateness_is_reported(ping_at: Pings) -> None:
    pings = [ping_at(k, k + 1.0, arrival(k + 1.0, 30 * MS if k == 4 else 0)) for k in range(6)]
    assert [time.lateness_ns for time in placed(SonarClock(), pings)] == [0] * 4 + [30 * MS, 0]


def test_a_change_of_range_does_not_move_the_clock(ping_at: Pings) -> None:
    clock = SonarClock()
    for k in range(20):
        rows = 50 if k % 2 else 400
        image = np.zeros((rows, 256), np.uint8)
        time = clock.place(ping_at(k, k + 1.0, arrival(k + 1.0, 0, rows * 400_000), image=image))
        assert time is not None
        assert (time.transmit_ns, time.lateness_ns) == (BOOT_NS + (k + 1) * S, 0)


def test_the_drift_of_the_sonar_is_followed(ping_at: Pings) -> None:
    clock = SonarClock()
    pings = [ping_at(k, k / 10 * (1 - 80e-6), arrival(k / 10)) for k in range(1, 600)]
    last = placed(clock, pings)[-1]
    assert clock.drift == pytest.approx(80e-6, rel=1e-2)
    assert abs(last.transmit_ns - (BOOT_NS + 599 * S // 10)) < 20_000


def test_the_latency_that_is_known_is_subtracted(ping_at: Pings) -> None:
    clock = SonarClock(latency_ns=3 * MS)
    time = clock.place(ping_at(1, 5.0, arrival(5.0, 3 * MS)))
    assert time is not None
    assert time.transmit_ns == BOOT_NS + 5 * S


@pytest.mark.parametrize("start_s", [None, 0.0, 1e10, 1e300])
def test_without_a_start_time_the_arrival_counts(ping_at: Pings, start_s: float | None) -> None:
    clock = SonarClock()
    for k in range(5):
        ping = ping_at(k, start_s, arrival(k + 1.0))
        time = clock.place(ping)
        assert time is not None
        assert (time.method, time.transmit_ns) == ("arrival", BOOT_NS + (k + 1) * S)
        assert time.transmit_ns == ping.transmit_time_ns()
    assert clock.period_s == pytest.approx(1.0)


def test_without_an_arrival_there_is_no_time(ping_at: Pings) -> None:
    assert SonarClock().place(ping_at(1, 5.0, None)) is None


def test_a_start_time_that_stands_still_is_found_out(ping_at: Pings) -> None:
    clock = SonarClock()
    times = placed(clock, (ping_at(k, 7.0, arrival(k / 10)) for k in range(200)))
    assert times[-1].method == "arrival"
    assert times[-1].transmit_ns == BOOT_NS + 199 * S // 10


def test_a_restart_of_the_sonar_costs_no_ping(ping_at: Pings) -> None:
    clock = SonarClock()
    before = [ping_at(5000 + k, 900.0 + k, arrival(900.0 + k)) for k in range(5)]
    after = [ping_at(k, 1.0 + k, arrival(930.0 + k)) for k in range(5)]
    times = placed(clock, before + after)
    assert [time.transmit_ns - BOOT_NS for time in times[5:]] == [(930 + k) * S for k in range(5)]
    assert {time.method for time in times} == {"device"}
    assert clock.restarts == 1
    assert clock.period_s == pytest.approx(1.0)


def test_a_stray_id_is_no_restart(ping_at: Pings) -> None:
    clock = SonarClock()
    ids = [5000, 5001, 5002 ^ 1 << 31, 5003]
    placed(clock, (ping_at(n, 900.0 + k, arrival(900.0 + k)) for k, n in enumerate(ids)))
    assert clock.restarts == 0


def test_a_stray_start_time_moves_one_ping_only(ping_at: Pings) -> None:
    starts = [10.0, 11.0, 12e6, 13.0, 14.0]
    pings = [ping_at(k, start, arrival(10.0 + k)) for k, start in enumerate(starts)]
    times = placed(SonarClock(), pings)
    assert [time.transmit_ns - BOOT_NS for time in times] == [(10 + k) * S for k in range(5)]
    assert [time.method for time in times] == ["device"] * 2 + ["arrival"] + ["device"] * 2


def test_the_period_counts_lost_pings_and_forgives_a_hiccup(ping_at: Pings) -> None:
    clock = SonarClock()
    assert clock.period_s is None
    for k in (0, 1, 2, 6, 7, 7, 8):
        start_s = 10 + k / 40 + (0.5 if k == 8 else 0.0)
        clock.place(ping_at(2**32 - 4 + k & 0xFFFFFFFF, start_s, arrival(start_s, k * MS)))
    assert clock.period_s == pytest.approx(1 / 40)


def test_lost_pings_do_not_make_the_period_longer(ping_at: Pings) -> None:
    clock = SonarClock()
    placed(clock, (ping_at(3 * k, 10 + 3 * k / 40, arrival(10 + 3 * k / 40)) for k in range(9)))
    assert clock.period_s == pytest.approx(1 / 40)


def test_the_period_is_not_taken_over_long_gaps_and_restarts(ping_at: Pings) -> None:
    clock = SonarClock()
    placed(clock, [ping_at(k, 10.0 + k / 5, arrival(10.0 + k / 5)) for k in (0, 5000)])
    assert clock.period_s is None
    placed(clock, [ping_at(5000 + k, 1010.0 + k, arrival(1010.0 + k)) for k in range(1, 9)])
    assert clock.period_s == pytest.approx(1.0)
    placed(clock, [ping_at(k, 1.0 + k / 4, arrival(1030.0 + k / 4)) for k in range(2)])
    assert clock.period_s == pytest.approx(0.25)


def test_ticks_of_version_1_are_used_where_their_length_is_given(captured: list[Message]) -> None:
    pings = [decode_ping(message) for message in captured]
    clock, unknown = SonarClock(tick_ns=8.0), SonarClock()
    for k, ping in enumerate(pings):
        assert isinstance(ping, Ping)
        clock.place(replace(ping, arrival_ns=BOOT_NS + k * S // 2))
        unknown.place(replace(ping, arrival_ns=BOOT_NS + k * S // 2))
    assert clock.period_s == pytest.approx((62502130 + 62502097) / 2 * 8e-9, rel=1e-12)
    assert clock.placed == {"device": 3}
    assert unknown.placed == {"arrival": 3}


def test_ticks_run_on_over_wraps_and_long_pauses(ping_at: Pings) -> None:
    clock = SonarClock(tick_ns=8.0)
    starts = [30.0, 34.0, 35.0, 69.0, 200.0, 201.0]  # a wrap every 34.36 s
    for k, start_s in enumerate(starts):
        ticks = round(start_s * 125e6) % 2**32
        time = clock.place(ping_at(k, None, arrival(start_s, k * MS), start_ticks=ticks))
        assert time is not None
        assert time.method == "device"
        late_ns = time.transmit_ns - (BOOT_NS + round(start_s * S))
        assert late_ns + time.lateness_ns == k * MS
        assert late_ns == 0 or k > 2  # a prompt ping is remembered for 30 s


def test_wraps_that_nobody_saw_are_counted_by_the_arrivals(ping_at: Pings) -> None:
    clock = SonarClock(tick_ns=1.0)  # a wrap every 4.3 s
    for k, start_s in enumerate((1.0, 2.0, 20.0, 29.0)):
        ticks = round(start_s * 1e9) % 2**32
        time = clock.place(ping_at(k, None, arrival(start_s, k * 100 * MS), start_ticks=ticks))
        assert time is not None
        assert time.lateness_ns == pytest.approx(k * 100 * MS, abs=6 * MS)
    assert clock.period_s == pytest.approx(9.0)


def test_ticks_start_again_with_the_sonar(ping_at: Pings) -> None:
    clock = SonarClock(tick_ns=8.0)
    for n, ticks, host_s in ((900, 4_000_000_000, 0.0), (1, 125, 20.0), (2, 125_000_125, 21.0)):
        time = clock.place(ping_at(n, None, arrival(host_s), start_ticks=ticks))
        assert time is not None
        assert (time.transmit_ns, time.method) == (BOOT_NS + round(host_s * S), "device")
    assert clock.restarts == 1


def test_rows_are_valid_when_their_sound_met_the_target(ping_at: Pings) -> None:
    ping = ping_at(1, 5.0, arrival(5.0))
    times = row_times_ns(ping, 7 * S)
    expected = 7 * S + ping.ranges_m / ping.speed_of_sound_mps * 1e9
    assert times.dtype == np.int64
    assert times.shape == (50,)
    assert np.abs(times - expected).max() <= 1
    assert times[0] == 7 * S + 100_000  # half a row of 0.3 m at 1500 m/s


def test_rows_of_a_ping_with_an_impossible_speed_of_sound_have_times(ping_at: Pings) -> None:
    times = row_times_ns(ping_at(1, 5.0, arrival(5.0), speed_of_sound_mps=0.0), 0)
    assert times[-1] == round(49.5 * 0.3 / 1500 * 1e9)
