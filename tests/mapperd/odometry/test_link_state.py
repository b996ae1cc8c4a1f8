import re
from random import Random

import pytest

from mapperd.odometry.decoder import LineDecoder
from mapperd.odometry.links import (
    BURST,
    GARBAGE,
    GARBAGE_BURST,
    RATE,
    InputLimit,
    LinkPhase,
    OdometryLinkState,
)
from mapperd.odometry.nmea import NmeaReader

S = 1_000_000_000


def test_a_link_names_what_it_does_and_since_when() -> None:
    link = OdometryLinkState("TCP dvl:16171", connects=True)
    link.opening(1 * S)
    link.opened(2 * S)
    assert (link.status.phase, link.overdue_ns) == (LinkPhase.WAITING, 7 * S)
    link.received(10, 3 * S)
    link.received(5, 4 * S)
    status = link.status
    assert (status.phase, status.since_ns, status.bytes_received) == ("receiving", 3 * S, 15)
    assert status.time_in_phase_s(5 * S) == 2.0
    assert link.tick(9 * S - 1) is False
    assert link.tick(9 * S) is False
    assert link.status.phase == "silent"
    assert re.search(r"\b5 s\b.*TCP dvl:16171", link.status.reason)
    link.received(1, 10 * S)
    assert link.status.phase == "receiving"
    link.tick(15 * S)
    assert not link.tick(25 * S - 1)
    assert link.tick(25 * S)  # no word for 15 s: the connection is dead, whatever TCP thinks


def test_a_port_that_only_listens_is_silent_for_ever() -> None:
    link = OdometryLinkState("UDP 127.0.0.1:1", connects=False)
    link.opened(0)
    link.tick(5 * S)
    assert (link.status.phase, link.overdue_ns) == ("silent", None)
    assert not link.tick(10_000 * S)


def test_pauses_grow_and_start_again_once_bytes_came() -> None:
    link = OdometryLinkState("x", connects=True)
    assert [link.lost("refused", 0) for _ in range(5)] == [
        S // 2,
        1 * S,
        2 * S,
        4 * S,
        5 * S,
    ]
    link.opened(10 * S)
    link.received(1, 10 * S)
    assert link.lost("reset", 11 * S) == 11 * S + S // 2
    assert (link.status.losses, link.status.opened, link.status.reason) == (6, 1, "reset")


def test_a_vehicle_is_far_below_the_limit() -> None:
    limit = InputLimit()
    for k in range(200_000):  # a serial line of 921600 baud, in pieces of 16 bytes
        assert limit.passed(b"x" * 16, k * S // 5760, (16 * k, k)) == b"x" * 16
    assert (limit.bytes_dropped, limit.reason) == (0, "")


@pytest.mark.slow
def test_a_flood_is_cut_to_the_limit_in_long_runs() -> None:
    limit, kept, runs = InputLimit(), 0, 0
    was_kept = False
    for k in range(8 * 1024 * 60):  # 8 MiB/s for a minute
        passed = limit.passed(b"x" * 1024, k * S // 8192, (kept, kept // 2))
        kept += len(passed)
        runs += bool(passed) and not was_kept
        was_kept = bool(passed)
    assert 59 * RATE < kept < 61 * RATE + BURST
    assert kept / runs > 32 * 1024
    assert (limit.bytes_dropped, limit.reason) == (8 * 1024 * 1024 * 60 - kept, "over 256 KiB/s")
    assert limit.passed(b"x", 80 * S, (kept, kept // 2)) == b"x"
    assert limit.reason == ""


@pytest.mark.slow
def test_garbage_takes_almost_nothing_of_the_recordings() -> None:
    limit, kept = InputLimit(), 0
    for k in range(128 * 60 * 60):  # 8 MiB/s for an hour
        kept += len(limit.passed(b"x" * 65536, k * S // 128, (kept, kept)))
    assert kept < 2 * BURST + 3600 * 1024
    assert limit.reason == "hardly any valid frame"


def test_frames_that_are_valid_by_chance_do_not_make_garbage_a_vehicle() -> None:
    """Random sentences at 8 MB/s: the check of one in 256 is right."""
    chance = Random(1)  # noqa: S311 no secret
    decoder = LineDecoder(NmeaReader(), 1000)
    limit, kept, seconds = InputLimit(), 0, 60
    lines = [b"$GPGGA,%d*%02X\r\n" % (k, chance.randrange(256)) for k in range(3000)]
    block = b"".join(lines)[:65536]
    for k in range(128 * seconds):
        counters = decoder.counters
        part = limit.passed(block, k * S // 128, (counters.bytes_total, counters.bytes_skipped))
        kept += len(part)
        list(decoder.feed(part, None))
    assert decoder.counters.frames > 2
    assert kept < 2 * BURST + seconds * 1024
    assert limit.reason == "hardly any valid frame"


def test_a_link_recovers_from_garbage() -> None:
    limit = InputLimit()
    assert len(limit.passed(b"x" * 65536, 0, (2 * GARBAGE, 2 * GARBAGE))) == 4096
    text = b"".join(b"$%018d\n" % k for k in range(3000))
    seen = b""
    for k in range(len(text) // 10):  # lines of 20 bytes, in pieces of 10, 50 a second
        seen += limit.passed(text[10 * k : 10 * k + 10], k * S // 50, (2 * GARBAGE, 2 * GARBAGE))
    assert len(seen) < 0.7 * len(text)
    lines = {line for line in text.splitlines() if line in seen.splitlines()}
    assert len(lines) > 500  # whole lines come through, again and again
    decoded = (2 * GARBAGE + GARBAGE_BURST, 2 * GARBAGE + GARBAGE_BURST // 2)
    assert limit.passed(b"x" * 100, 130 * S, decoded) == b"x" * 100
