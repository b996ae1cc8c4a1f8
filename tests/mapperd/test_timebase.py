import random

from mapperd.timebase import WINDOW_NS, LowerEnvelope

MS = 1_000_000
S = 1_000_000_000


def test_constant_delay_gives_arrival() -> None:
    clock = LowerEnvelope()
    for k in range(10):
        assert clock.to_host_ns(k * S, 500 * S + k * S) == 500 * S + k * S


def test_late_records_keep_their_own_time() -> None:
    clock = LowerEnvelope()
    assert clock.to_host_ns(0, 100 * S) == 100 * S
    assert clock.to_host_ns(S, 101 * S + 200 * MS) == 101 * S


def test_noise_of_delay_is_taken_out() -> None:
    rng = random.Random(1)  # noqa: S311 a test
    clock, errors = LowerEnvelope(), []
    for k in range(600):
        stamp = k * 100 * MS
        delay = 2 * MS + round(rng.expovariate(1 / (6 * MS)))
        host = clock.to_host_ns(stamp, 1000 * S + stamp + delay)
        assert host is not None
        errors.append(host - (1000 * S + stamp))
    assert max(errors[50:]) < 4 * MS


def test_drift_is_followed() -> None:
    clock, host = LowerEnvelope(), 0
    for k in range(1000):
        stamp = k * 100 * MS
        arrival = round(stamp * (1 + 1e-4))
        host = clock.to_host_ns(stamp, arrival) or 0
        assert abs(host - arrival) <= WINDOW_NS * 1e-4 + 1
    assert host > 0


def test_one_stray_stamp_changes_nothing() -> None:
    clock = LowerEnvelope()
    for k in range(5):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(10**18, 105 * S) is None
    assert clock.to_host_ns(6 * S, 106 * S) == 106 * S
    assert clock.to_host_ns(2 * S, 107 * S) is None
    assert clock.to_host_ns(8 * S, 108 * S) == 108 * S


def test_restart_of_the_sender_is_believed_at_its_second_record() -> None:
    clock = LowerEnvelope()
    for k in range(50, 55):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(0, 160 * S) is None
    assert clock.to_host_ns(S, 161 * S) == 161 * S


def test_stall_does_not_move_the_clock() -> None:
    clock = LowerEnvelope()
    for k in range(5):
        clock.to_host_ns(k * S, (100 + k) * S)
    assert clock.to_host_ns(5 * S, 108 * S) == 105 * S
    assert clock.to_host_ns(6 * S, 108 * S) == 106 * S
    assert clock.to_host_ns(9 * S, 109 * S) == 109 * S
