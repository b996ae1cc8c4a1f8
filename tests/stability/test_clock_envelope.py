"""Hard cases of a sender's clock fitted from below, and of the clocks of odometry."""

from __future__ import annotations

import random
from fractions import Fraction

import mpmath as mp
import pytest

from mapperd.errors import Reject
from mapperd.odometry.clock import OdometryClock
from mapperd.odometry.mavlink import WRAP_MS, BootClock
from mapperd.odometry.nmea import DAY_NS, UtcDay
from mapperd.odometry.records import Odometry
from oculus_driver.clock_fit import MAX_DRIFT, WINDOW_NS, ClockFit

MS = 1_000_000
S = 1_000_000_000
NOW_NS = 1_700_000_000 * S
SLACK_NS = 2 * S // 1_000_000


def drifted(true_ns: int, ppm: int) -> int:
    """Return the exact reading of a clock that is slow by this many parts per million."""
    return round(true_ns * Fraction(1_000_000 - ppm, 1_000_000))


def errors_ns(
    ppm: int, hours: float, every_ns: int, delay_ns: int = 0
) -> tuple[ClockFit, list[int]]:
    """A sender whose records take up to so long, followed for hours."""
    chance, clock, errors = random.Random(8), ClockFit(), []  # noqa: S311 a test
    for k in range(int(hours * 3600 * S / every_ns)):
        true_ns = k * every_ns
        late_ns = round(chance.expovariate(1 / delay_ns)) if delay_ns else 0
        host = clock.to_host_ns(drifted(true_ns, ppm), NOW_NS + true_ns + late_ns)
        assert host is not None
        errors.append(host - NOW_NS - true_ns)
    return clock, errors


@pytest.mark.parametrize("ppm", [-100, 100])
def test_drift_of_a_crystal_for_ten_hours(ppm: int) -> None:
    """100 ppm are measured and taken out: after ten hours the error is that of the first minute.

    Naively the offset is learnt once: it is off by 3.6 s at the end of the day.
    """
    clock, errors = errors_ns(ppm, 10, 2 * S)
    assert clock.drift == pytest.approx(ppm * 1e-6, rel=1e-6)
    assert max(map(abs, errors[15:])) <= SLACK_NS
    assert clock.is_valid


@pytest.mark.parametrize("ppm", [-1000, 1000])
def test_drift_of_1000_ppm(ppm: int) -> None:
    """No crystal drifts so; the error is bounded by what the window holds, 24 ms, for hours.

    Naively a slope without a limit follows a link that grows slower just as well, and with the
    offset of the beginning the clock is off by 3.6 s after the first hour.
    """
    clock, errors = errors_ns(ppm, 2, S)
    assert abs(clock.drift) == pytest.approx(MAX_DRIFT)
    max_ns = (1000e-6 - MAX_DRIFT) * WINDOW_NS * (1 + MAX_DRIFT) + SLACK_NS
    assert max(map(abs, errors)) <= max_ns
    assert max(map(abs, errors[-600:])) <= max(map(abs, errors[60:660])) + SLACK_NS


def test_noise_of_delay_for_an_hour() -> None:
    """Of delays of 5 ms on average, at 2 Hz, a mean error of 0.3 ms is left, at the end as before.

    Naively a least-squares line lies in the middle of the delays, 5 ms late, and wanders.
    """
    _, errors = errors_ns(50, 1, S // 2, 5 * MS)
    assert max(map(abs, errors[60:])) < 2.5 * MS
    for part in (errors[60:1260], errors[-1200:]):
        assert abs(sum(part)) / len(part) < 0.3 * MS


def test_line_at_unix_nanoseconds() -> None:
    """The fitted line is exact to 2 ns, at 1.7e18 of them: sums are of whole numbers.

    Naively sums of squares of 1.7e9 s lose all digits of a slope of 1e-4, as 40 digits show.
    """
    clock, ppm = ClockFit(), 87
    for k in range(100):
        true_ns = k * 300 * MS
        host = clock.to_host_ns(5 * S + drifted(true_ns, ppm), NOW_NS + true_ns)
    assert host is not None
    with mp.workdps(40):
        slope = 1 / (1 - mp.mpf(ppm) / 1_000_000) - 1
        assert abs(mp.mpf(clock.drift) - slope / (1 + slope)) < 1e-9
    assert abs(host - (NOW_NS + true_ns)) <= 2


def test_least_squares_at_unix_seconds() -> None:
    """The drift that the envelope finds is the one that 40 digits find in the same points.

    Naively the normal equations in doubles, about zero, are singular: their slope is anything.
    """
    points = [(NOW_NS + k * 300 * MS, 5 * S + round(k * 300 * MS * 1e-4)) for k in range(100)]
    clock = ClockFit()
    for arrival_ns, offset_ns in points:
        clock.to_host_ns(arrival_ns - offset_ns, arrival_ns)
    with mp.workdps(40):
        xs, ys = [mp.mpf(x) for x, _ in points], [mp.mpf(y) for _, y in points]
        n, sx, sy = len(points), mp.fsum(xs), mp.fsum(ys)
        sxx, sxy = mp.fsum(x * x for x in xs), mp.fsum(x * y for x, y in points)
        exact = float((n * sxy - sx * sy) / (n * sxx - sx * sx))
    floats = [(x / S, y / S) for x, y in points]
    fx, fy = sum(x for x, _ in floats), sum(y for _, y in floats)
    fxx, fxy = sum(x * x for x, _ in floats), sum(x * y for x, y in floats)
    over = n * fxx - fx * fx
    naive = (n * fxy - fx * fy) / over if over else 0.0
    assert clock.drift == pytest.approx(exact, rel=1e-6)
    assert naive != pytest.approx(exact, rel=0.1)


def test_one_record_alone() -> None:
    """One stamp gives an offset and no drift: it is placed at its arrival.

    Naively two unknowns are solved for with one equation.
    """
    clock = ClockFit()
    assert clock.to_host_ns(123, NOW_NS) == NOW_NS
    assert clock.drift == 0.0
    assert clock.is_valid


def test_burst_of_records_in_one_nanosecond() -> None:
    """Records that a stall let out all at once have one arrival, and the line goes on below them.

    Naively the slope between two of them is divided by 0.
    """
    clock = ClockFit()
    for k in range(200):
        clock.to_host_ns(k * S // 10, NOW_NS + k * S // 10)
    for k in range(200, 400):
        host = clock.to_host_ns(k * S // 10, NOW_NS + 40 * S)
        assert host == NOW_NS + k * S // 10
    assert clock.drift == 0.0


def test_stamps_all_alike() -> None:
    """Stamps that stand still are not a clock, and are reported as invalid.

    Naively they are fitted with a drift of -1, and all records lie at one moment.
    """
    clock = ClockFit()
    for k in range(200):
        clock.to_host_ns(5 * S, NOW_NS + k * S // 10)
    assert not clock.is_valid
    assert abs(clock.drift) <= MAX_DRIFT


@pytest.mark.parametrize("step_ns", [-3600 * S, 3600 * S, -(10**18), 10**18])
def test_step_of_the_senders_clock(step_ns: int) -> None:
    """A clock that is set costs one record; from the second on all is right again.

    Naively the step is a drift of 1e4, or an outlier for ever; and both ends of it in one line
    put records half an hour off.
    """
    clock, missed = ClockFit(), 0
    for k in range(300):
        true_ns = k * S // 5
        stamp = 10**18 + true_ns + (step_ns if k >= 150 else 0)
        host = clock.to_host_ns(stamp, NOW_NS + true_ns)
        missed += host is None
        assert host is None or host == NOW_NS + true_ns
    assert missed == 1
    assert clock.drift == 0.0


def test_step_of_the_hosts_clock() -> None:
    """Set back by an hour and on again, the host's clock is followed, and old points are dropped.

    Naively points of the other time stay in the window for ever, for they are never 30 s old.
    """
    clock = ClockFit()
    for k in range(900):
        true_ns = k * S // 5
        set_ns = -3600 * S if 300 <= k < 600 else 0
        host = clock.to_host_ns(true_ns, NOW_NS + true_ns + set_ns)
        if k % 300 >= 5:
            assert host == NOW_NS + true_ns + set_ns, k
            assert clock.drift == 0.0
            assert clock.is_valid


def test_outlier_of_a_stamp_that_is_early() -> None:
    """A stamp half a second ahead of its time pulls the line up to it for a window, and no longer.

    Naively a minimum since the beginning keeps it, and every record is half a second off for good.
    """
    clock, errors = ClockFit(), []
    for k in range(600):
        true_ns = k * S // 5
        early_ns = S // 2 if k == 100 else 0
        host = clock.to_host_ns(true_ns + early_ns, NOW_NS + true_ns)
        errors.append(None if host is None else abs(host - NOW_NS - true_ns))
    behind = [error for error in errors[101 + 5 * 30 + 2 :] if error is None or error > 0]
    assert not behind
    assert max(error or 0 for error in errors) <= S // 2 + SLACK_NS


def test_boot_milliseconds_over_49_days() -> None:
    """A 32-bit counter of milliseconds wraps, overtaken datagrams of before it keep their time.

    Naively the vehicle jumps 49.7 days back, and forth again with the datagram that came late.
    """
    clock = BootClock()
    start = WRAP_MS - 50
    for off_ms in (0, 20, 49, 50, 51, 45, 70, 200):
        assert clock.stamp_ns((start + off_ms) % WRAP_MS) == (start + off_ms) * MS
    assert clock.reboots == 0


def test_reboot_is_no_wrap() -> None:
    """A counter that falls from anywhere but its end has restarted.

    Naively 49.7 days are added at every reboot, and the stamps lie years ahead.
    """
    clock = BootClock()
    for boot_ms in (5_000_000, 5_001_000, 10, 1010, WRAP_MS // 2, 3):
        assert clock.stamp_ns(boot_ms) == boot_ms * MS
    assert clock.reboots == 2


def test_time_of_day_over_midnight() -> None:
    """After 23:59:59 comes the next day, though the date is sent a minute later; and back again.

    Naively the vehicle goes back by a day at midnight, until the next sentence with a date.
    """
    day = UtcDay()
    day.learn("14", "11", "2023")  # 1 700 000 000 s is at 22:13:20 of it
    times = ("235959.900", "000000.100", "235959.950", "000000.200")
    midnight_ns = (NOW_NS // DAY_NS + 1) * DAY_NS
    expected = [midnight_ns + off * MS for off in (-100, 100, -50, 200)]
    assert [day.stamp(text, NOW_NS)[0] for text in times] == expected
    leap, _ = day.stamp("235960.5", NOW_NS)
    assert abs(leap - midnight_ns) <= S


def test_unix_stamps_of_a_clock_that_was_never_set() -> None:
    """A sender that thinks it is 1970 is fitted, and its records keep their time to a microsecond.

    Naively they are believed and lie 53 years back, or refused for ever.
    """
    clock, placed = OdometryClock(max_age_ns=2 * S), []
    for k in range(100):
        true_ns = k * S // 20
        late_ns = 7 * MS if k % 3 else 0
        record = Odometry(stamp_ns=1000 + true_ns, clock="unix")
        host = clock.t_host_ns(record, NOW_NS + true_ns + late_ns)
        if k >= 15:
            assert not isinstance(host, Reject)
            placed.append(host - NOW_NS - true_ns)
    assert max(map(abs, placed)) <= 1000
