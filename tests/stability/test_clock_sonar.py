"""Hard cases of the sonar's clock carried over to the host's."""

from __future__ import annotations

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

from oculus_driver import (
    Ping,
    PingTime,
    SonarClock,
    StreamParser,
    bearing_table_cdeg,
    decode_ping,
    encode_ping,
    row_times_ns,
)
from oculus_driver.ping import PingSequence

MS = 1_000_000
S = 1_000_000_000
BOOT_NS = 1_700_000_000 * S
FLIGHT_NS = 20 * MS


def shown() -> Ping:
    """50 rows of 0.3 m: 20 ms there and back."""
    beams = 256
    data = encode_ping(
        ping_id=7,
        mode=1,
        frequency_hz=750e3,
        range_m=15.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=12.5,
        range_resolution_m=0.3,
        bearings_cdeg=bearing_table_cdeg(beams, np.pi / 3),
        image=np.zeros((50, beams), np.uint8),
        source_id=7892,
    )
    parser = StreamParser()
    (message,) = parser.feed(data, arrival_ns=BOOT_NS) + parser.finish()
    ping = decode_ping(message)
    assert isinstance(ping, Ping)
    return ping


PING = shown()


def placed(
    clock: SonarClock,
    number: int,
    start_s: float | None,
    arrival_ns: int,
    *,
    ticks: int | None = None,
) -> PingTime:
    ping = replace(
        PING, ping_id=number, start_time_s=start_s, start_ticks=ticks, arrival_ns=arrival_ns
    )
    time = clock.place(ping)
    assert time is not None
    return time


def test_32_bit_ticks_for_ten_hours() -> None:
    """A counter of 8 ns that wraps every 34 s runs on through a thousand wraps, to the nanosecond.

    Naively a wrap is a step back of 34 s, or the wraps are added up as floats and lose their end.
    """
    clock = SonarClock(tick_ns=8.0)
    for k in range(3600):
        at_ns = BOOT_NS + k * 10 * S + 8 * k
        time = placed(clock, k, None, at_ns + FLIGHT_NS, ticks=(at_ns // 8) % 2**32)
        assert (time.method, time.transmit_ns) == ("device", at_ns)
    assert clock.restarts == 0


def test_ticks_that_wrap_where_a_ping_is_late() -> None:
    """A late ping right after a wrap is placed by its ticks, not by a wrap too many.

    Naively wraps are counted by rounding the arrivals alone, and half a period late is one more.
    """
    clock = SonarClock(tick_ns=8.0)
    period_ns = 2**32 * 8
    for k, late_ns in enumerate((0, 0, period_ns // 2 - S, 0, 0)):
        at_ns = BOOT_NS // 8 * 8 + k * period_ns // 8 * 8
        time = placed(clock, k, None, at_ns + FLIGHT_NS + late_ns, ticks=(at_ns // 8) % 2**32)
        assert time.end_ns + time.lateness_ns == at_ns + FLIGHT_NS + late_ns
    assert time.transmit_ns == at_ns


def test_start_times_near_the_end_of_their_digits() -> None:
    """A start time of 30 years in float seconds is good to 120 ns, and no error is added to that.

    Naively it is taken from Unix seconds, as floats again, and the row times are microseconds off.
    """
    start_s = 0.999e9
    clock = SonarClock()
    for k in range(50):
        start = start_s + 0.1 * k
        with mp.workdps(40):
            exact_ns = int(mp.nint((mp.mpf(start_s) + mp.mpf(k) / 10) * S))
        time = placed(clock, k, start, BOOT_NS + exact_ns + FLIGHT_NS)
        assert abs(time.transmit_ns - (BOOT_NS + exact_ns)) <= 120


@pytest.mark.parametrize("start_s", [0.0, -1.0, 1e9, 1e300, float("inf"), float("nan"), None])
def test_start_time_that_is_invalid(start_s: float | None) -> None:
    """Zero, left-over memory, or no number where the start time should be: the arrival counts.

    Naively infinity is rounded to an integer, which raises, and NaN is earlier and later than all.
    """
    clock = SonarClock()
    for k in range(12):
        time = placed(clock, k, start_s, BOOT_NS + k * S)
        assert (time.method, time.end_ns) == ("arrival", BOOT_NS + k * S)
    assert clock.restarts == 0


def test_ids_that_wrap() -> None:
    """After ping 2^32 - 1 comes ping 0: none is lost, nothing has restarted, the period stays.

    Naively four thousand million pings are lost, or the sonar is thought to have restarted.
    """
    clock, sequence = SonarClock(), PingSequence()
    for k in range(2):
        number = (2**32 - 1 + k) % 2**32
        placed(clock, number, 5000.0 + k / 8, BOOT_NS + (5000 * 8 + k) * S // 8 + FLIGHT_NS)
        assert sequence.accept(number)
    assert clock.restarts == 0
    assert clock.period_s == pytest.approx(1 / 8, abs=1e-9)
    assert (sequence.lost_pings, sequence.duplicates, sequence.restarts) == (0, 0, 0)


def test_restart_again_and_again() -> None:
    """A sonar whose supply fails every few seconds is placed right from its first ping each time.

    Naively the old offset is kept until the fit forgets it: pings lie minutes in the past.
    """
    clock = SonarClock()
    for life in range(20):
        began_ns = BOOT_NS + life * 7 * S
        for k in range(5):
            time = placed(clock, k + 1, 1.0 + k, began_ns + (1 + k) * S + FLIGHT_NS)
            assert (time.method, time.transmit_ns) == ("device", began_ns + (1 + k) * S)
    assert clock.restarts == 19


def test_row_times_at_unix_nanoseconds() -> None:
    """Each row's time is right to the nanosecond, though 1.7e18 is not a whole number of a double.

    Naively the way of the sound is added to a float of the transmission: steps of 256 ns.
    """
    times = row_times_ns(PING, BOOT_NS + 1)
    with mp.workdps(30):
        row_ns = mp.mpf(PING.range_resolution_m) / mp.mpf(PING.speed_of_sound_mps) * S
        exact = [BOOT_NS + 1 + int(mp.nint((k + mp.mpf(1) / 2) * row_ns)) for k in range(50)]
    assert times.dtype == np.int64
    assert np.abs(times - np.array(exact)).max() <= 1
    assert (np.diff(times) > 0).all()


def test_one_ping_alone() -> None:
    """The first ping is placed by its arrival less the way of its sound; there is no drift yet.

    Naively a line through one point has any slope: 0 / 0.
    """
    clock = SonarClock()
    time = placed(clock, 1, 3.0, BOOT_NS)
    assert (time.end_ns, time.transmit_ns) == (BOOT_NS, BOOT_NS - FLIGHT_NS)
    assert clock.drift == 0.0
    assert clock.period_s is None
