"""From bytes to pings, once each, and when to give up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from oculus_driver import encode_dummy
from oculus_driver.link.receiver import (
    MAX_RESYNC_BYTES,
    RESYNC_TIMEOUT_NS,
    STALL_TIMEOUT_NS,
    PingReceiver,
    ReceivedMessage,
)
from oculus_driver.stream import MessageBounds
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    from tests.oculus_driver.conftest import MakePing

S = 1_000_000_000


def ids(received: list[ReceivedMessage]) -> list[int]:
    return [one.ping.ping_id for one in received if one.ping is not None]


def deadline_ns(receiver: PingReceiver) -> int | None:
    return receiver.deadline_ns


def test_any_split_gives_each_ping_once(make_ping: MakePing) -> None:
    stream = b"".join(make_ping(ping_id=1 + n) + encode_dummy() for n in range(4))
    for size in (1, 7, 1000, len(stream)):
        receiver = PingReceiver()
        received = [
            one
            for start in range(0, len(stream), size)
            for one in receiver.feed(stream[start : start + size], start)
        ]
        assert ids(received) == [1, 2, 3, 4]
        assert [one.message_id for one in received[:2]] == [MessageId.PING_RESULT, MessageId.DUMMY]
        assert (receiver.pings, receiver.deadline_ns) == (4, None)


def test_bounds_follow_a_new_connection(make_ping: MakePing) -> None:
    ping, receiver = make_ping(), PingReceiver()
    receiver.feed(ping[:700], 0)
    assert receiver.framing.bounds == MessageBounds(0, 0)
    receiver.feed(ping[700:800], 1)
    assert receiver.framing.bounds == MessageBounds(100, -700)
    receiver.finish()
    receiver.feed(ping + ping[:5], 2)
    assert receiver.framing.bounds == MessageBounds(0, len(ping))
    assert receiver.framing.begin == 800


def test_the_captures_come_through(capture: bytes) -> None:
    # quirk 27: the image holds bytes that mean a new line to text readers.
    receiver = PingReceiver()
    received = receiver.feed(capture, 0)
    assert len(ids(received)) == 3
    assert receiver.sequence.lost_pings == 0
    assert receiver.stream.bytes_rejected == 0


def test_a_message_larger_than_200_000_bytes_comes_through(make_ping: MakePing) -> None:
    # quirk 33
    message = make_ping(rows=703, beams=512)
    assert len(message) > 200_000
    assert ids(PingReceiver().feed(message, 0)) == [7]


def test_repeated_lost_and_rejected_pings_are_counted(make_ping: MakePing) -> None:
    receiver = PingReceiver()
    empty = make_ping(ping_id=3, range_resolution_m=0.0)
    stream = [make_ping(ping_id=1), make_ping(ping_id=1), empty, make_ping(ping_id=6)]
    assert ids(receiver.feed(b"".join(stream), 0)) == [1, 6]
    assert receiver.pings == 2
    assert receiver.rejects == {"bad_resolution": 1}
    assert (receiver.sequence.duplicates, receiver.sequence.lost_pings) == (1, 3)


@pytest.mark.parametrize("version", [1, 2])
def test_the_same_id_of_another_time_is_a_restart(make_ping: MakePing, version: int) -> None:
    receiver = PingReceiver()
    stream = [make_ping(ping_id=1, start_time=at, version=version) for at in (70, 70, 90)]
    assert ids(receiver.feed(b"".join(stream), 0)) == [1, 1]
    assert (receiver.sequence.duplicates, receiver.sequence.restarts) == (1, 1)


def test_the_next_connection_starts_afresh(make_ping: MakePing) -> None:
    receiver = PingReceiver()
    receiver.feed(make_ping(ping_id=1)[:700], 0)
    assert receiver.finish() == []
    assert ids(receiver.feed(make_ping(ping_id=2), S)) == [2]
    assert receiver.stream.rejects["truncated"] == 1
    assert receiver.stream.bytes_rejected == 700


def test_the_noise_of_one_connection_is_no_trouble_for_the_next() -> None:
    receiver = PingReceiver()
    receiver.feed(bytes(1000), 0)
    receiver.finish()
    assert deadline_ns(receiver) is None
    assert receiver.fault(60 * S) is None


def test_a_message_that_stops_is_trouble_after_two_seconds(make_ping: MakePing) -> None:
    message = make_ping()
    receiver = PingReceiver()
    receiver.feed(message[:100], S)
    receiver.feed(message[100:200], 2 * S)
    assert receiver.deadline_ns == 2 * S + STALL_TIMEOUT_NS
    assert receiver.fault(2 * S + STALL_TIMEOUT_NS - 1) is None
    assert "200 bytes" in (receiver.fault(2 * S + STALL_TIMEOUT_NS) or "")
    receiver.feed(message[200:], 3 * S)
    assert receiver.fault(60 * S) is None
    assert deadline_ns(receiver) is None


@pytest.mark.parametrize("chunk", [1000, 1 << 20])
def test_noise_is_trouble_after_16_mib_or_five_seconds(chunk: int) -> None:
    receiver = PingReceiver()
    fed, now_ns = 0, 0
    while receiver.fault(now_ns) is None:
        now_ns += S // 10
        receiver.feed(bytes(chunk), now_ns)
        fed += chunk
    if chunk == 1000:
        assert now_ns == S // 10 + RESYNC_TIMEOUT_NS
    else:
        assert fed == MAX_RESYNC_BYTES
    assert str(fed) in (receiver.fault(now_ns) or "")


def test_trouble_is_over_when_a_message_is_found(make_ping: MakePing) -> None:
    receiver = PingReceiver()
    receiver.feed(bytes(1000), 0)
    assert receiver.deadline_ns == RESYNC_TIMEOUT_NS
    assert ids(receiver.feed(make_ping() + encode_dummy(source_id=7892), S)) == [7]
    assert receiver.fault(60 * S) is None
    assert deadline_ns(receiver) is None


def test_the_first_ping_after_a_restart_is_new_even_if_it_is_the_same(make_ping: MakePing) -> None:
    ping = make_ping(ping_id=1)
    receiver = PingReceiver()
    assert ids(receiver.feed(ping + ping, 0)) == [1]  # twice over one connection: a repetition
    receiver.finish()
    assert ids(receiver.feed(ping + ping, 1)) == [1]
    assert (receiver.sequence.duplicates, receiver.sequence.restarts) == (2, 1)
