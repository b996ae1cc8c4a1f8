"""Hard cases of the map stream: how much is sent, by a clock and counters that may be odd."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from mapperd.server.pacer import MAX_IN_FLIGHT, MIN_BURST, MIN_WINDOW, Pacer
from mapperd.server.subscription import InFlight
from mapperd.wire.framing import StreamError, server_inbox
from mapperd.wire.messages import MAX_FROM_CLIENT


def sound(pacer: Pacer, now_s: float) -> None:
    assert isinstance(pacer.room(now_s), int)
    assert MIN_WINDOW <= pacer.window <= MAX_IN_FLIGHT
    assert pacer.rate is None or math.isfinite(pacer.rate)
    assert 0 <= pacer.least() <= MAX_IN_FLIGHT
    assert pacer.quiet_s(now_s) >= 0


def test_a_week_of_silence_is_no_credit_of_a_week() -> None:
    """A limit in bytes a second holds when a client that slept wakes up.

    Naively the time that has passed is multiplied by the limit: six gigabytes at once.
    """
    pacer = Pacer(bytes_per_s=10_000)
    for now_s in (0.0, 604_800.0, 1e12):
        room = pacer.room(now_s)
        assert room <= MIN_BURST
        pacer.note_sent(room, now_s)
        pacer.note_ack(pacer.sent, now_s)
        sound(pacer, now_s)


def rates(start_s: float) -> list[tuple[int, float, float]]:
    """A conversation of a minute that begins at a time, in ticks that doubles hold exactly."""
    pacer, wire, history = Pacer(), random.Random(5), []  # noqa: S311 the same in each run
    for tick in range(600):
        now_s = start_s + tick / 8
        room = pacer.room(now_s)
        if room > 0:
            pacer.note_sent(min(room, 4096), now_s)
        arrived = min(pacer.sent, pacer.acked + wire.randrange(3000))
        assert pacer.note_ack(arrived, now_s)
        waits = 0.125 + (0.5 if tick % 100 > 80 else 0.0)
        pacer.note_link(pacer.in_flight // 2, 0.125, waits, 0, 4000.0)
        history.append((room, pacer.window, pacer.rate or 0.0))
    return history


def test_a_host_that_is_up_for_years_paces_as_one_just_started() -> None:
    """Times are seconds since the machine started, or since 1970, and only differences count.

    Naively a time of 0 means "never", or the difference of large times loses the milliseconds.
    """
    assert rates(2.0**30) == rates(0.0) == rates(2.0**20)


def test_a_wire_of_a_byte_a_second_still_takes_messages() -> None:
    """An acoustic modem at its worst delivers less than a message a minute.

    Naively what may be sent is the rate times a moment, rounded down to nothing for good.
    """
    pacer = Pacer()
    now_s = 0.0
    for _ in range(60):
        now_s += 60.0
        pacer.note_ack(min(pacer.sent, pacer.acked + 60), now_s)
        pacer.note_link(0, 30.0, 30.0, 0, 1.0)
        if pacer.fits(500, now_s):
            pacer.note_sent(500, now_s)
        sound(pacer, now_s)
    assert pacer.sent > 60 * 60


def test_bytes_beyond_2_to_the_53_are_counted_one_by_one() -> None:
    """Counters of bytes go on for the life of a connection, and the client is held to them.

    Naively they pass through a double: an acknowledgement of one byte too many equals the truth.
    """
    pacer = Pacer()
    pacer.sent = pacer.acked = 2**60
    pacer.note_sent(1001, 1.0)
    assert pacer.in_flight == 1001
    assert not pacer.note_ack(2**60 + 1002, 1.1)
    assert pacer.note_ack(2**60 + 1, 1.1)
    assert pacer.in_flight == 1000
    assert not pacer.note_ack(2**60, 1.2)


def test_round_trips_from_nothing_to_an_hour_leave_a_window() -> None:
    """Round trips come from the system, which reports 0 for a local one and hours after a sleep.

    Naively the window is the rate times the round trip: nothing, for ever; or all memory.
    """
    for round_trip_s in (0.0, 1e-9, 1e-3, 1.0, 60.0, 3600.0):
        pacer, now_s = Pacer(), 0.0
        for _ in range(30):
            now_s += max(0.3, round_trip_s)
            pacer.note_link(0, round_trip_s, round_trip_s, 0, 8000.0)
            now_s += 3 * round_trip_s + 1.0
            pacer.note_link(0, round_trip_s, 3 * round_trip_s + 1.0, 0, 8000.0)
            size = max(pacer.room(now_s), 0)
            pacer.note_sent(size, now_s)
            pacer.note_ack(pacer.sent, now_s + 0.1)
            sound(pacer, now_s + 0.3)
        assert pacer.room(now_s + 1.0) > 0


@pytest.mark.parametrize("length", [MAX_FROM_CLIENT + 1, 2**31 - 1, 2**31, 2**32 - 1])
def test_a_length_of_all_bits_is_refused_before_it_is_waited_for(length: int) -> None:
    """Four bytes before each message give its length, and anybody may send them.

    Naively a length of 2**31 is a negative number, which is below every limit; or room for four
    gigabytes is made at once.
    """
    inbox = server_inbox()
    with pytest.raises(StreamError, match="allowed"):
        inbox.feed(length.to_bytes(4, "big"))
    assert len(inbox) <= 4


def test_messages_on_their_way_are_known_by_number_after_many_millions() -> None:
    """A client that reconnects names the message that it used last, of any number of messages.

    Naively numbers wrap at 2**32, or all of them are remembered: a client that comes back after a
    night receives the wrong blocks, or the daemon is out of memory.
    """
    way = InFlight()
    way.number = 2**32 - 3
    way.settle(way.number)
    for block in range(6):
        way.note(_numbers(block))
    assert way.number == 2**32 + 3
    assert way.beyond(2**32) is not None
    assert _listed(way.beyond(2**32)) == [3, 4, 5]
    assert _listed(way.beyond(2**32 + 3)) == []
    assert way.beyond(2**32 + 4) is None
    assert way.beyond(2**32 - 4) is None


def _numbers(block: int) -> np.ndarray:
    return np.array([block], np.int64)


def _listed(numbers: np.ndarray | None) -> list[int]:
    return [] if numbers is None else numbers.tolist()
