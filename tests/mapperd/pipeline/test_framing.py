"""A parser that adopts the driver's messages, beside one that parses all bytes itself."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mapperd.pipeline import framing as module
from mapperd.pipeline.framing import LinkParser
from oculus_driver.encode import encode_dummy
from oculus_driver.link.receiver import PingReceiver
from oculus_driver.stream import Framing, Message, MessageBounds, StreamParser
from oculus_driver.wire import HEADER

PingBytes = Callable[..., bytes]


class Both:
    """The driver's parser, one that adopts from it, and one that is fed the same bytes as that."""

    def __init__(self) -> None:
        self.driver = PingReceiver()
        self.mine, self.truth = LinkParser(), StreamParser()
        self.fed: list[bytes] = []
        self.found: list[Message] = []

    def receive(
        self, data: bytes, at_ns: int, *, gap: bool = False, framed: bool = True
    ) -> Framing:
        """The driver gets bytes and passes them on."""
        self.driver.feed(data, at_ns)
        framing = self.driver.framing
        found = self.mine.feed(data, at_ns, gap_before=gap, framing=framing if framed else None)
        assert found == self.truth.feed(data, at_ns, gap_before=gap)
        self.found += found
        return framing

    def compare(self) -> None:
        assert self.mine.state() == self.truth.state()

    def finish(self) -> None:
        found = self.mine.finish()
        assert found == self.truth.finish()
        assert self.mine.state() == self.truth.state()
        assert self.mine.counters == self.truth.counters


@pytest.fixture
def parsed_bytes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of bytes that are parsed for maps."""
    sizes: list[int] = []

    class Counting(StreamParser):
        def feed(self, data: bytes, *args: int | None, **kwargs: bool) -> list[Message]:  # type: ignore[override]
            sizes.append(len(data))
            return super().feed(data, *args, **kwargs)

    monkeypatch.setattr(module, "StreamParser", Counting)
    return sizes


def test_bytes_that_the_driver_framed_are_not_framed_again(
    ping_bytes: PingBytes, parsed_bytes: list[int]
) -> None:
    stream = b"".join(ping_bytes(k) + encode_dummy(source_id=7) for k in range(50))
    both = Both()
    for at in range(0, len(stream), 1000):
        both.receive(stream[at : at + 1000], at)
    assert len(both.found) == 100
    assert sum(parsed_bytes) < 2 * len(ping_bytes(1))  # until the sonar's id is known
    both.finish()


def test_after_a_new_connection_the_driver_is_followed_again(
    ping_bytes: PingBytes, parsed_bytes: list[int]
) -> None:
    both = Both()
    both.receive(ping_bytes(1) + ping_bytes(2)[:1000], 0)
    both.driver.finish()  # the connection is lost in the middle of a message
    # The driver finds the first message at once; a replay waits for the one behind it.
    both.receive(encode_dummy(source_id=7), 1, gap=True)
    both.receive(encode_dummy(source_id=7), 2)
    both.receive(ping_bytes(3)[:-9], 3)
    parsed_bytes.clear()
    both.receive(ping_bytes(3)[-9:], 4)
    for k in range(4, 20):
        both.receive(ping_bytes(k), k)
    assert [one.arrival_ns for one in both.found] == [0, 1, 2, 3, *range(4, 20)]
    assert sum(parsed_bytes) <= len(ping_bytes(3))
    both.finish()


@pytest.mark.parametrize(
    "other",
    [
        {"synchronised": False},
        {"source_id": 8},
        {"bounds": MessageBounds(0, 500)},
        {"begin": 1},
    ],
    ids=lambda other: next(iter(other)),
)
def test_a_parser_in_another_state_is_not_followed(
    ping_bytes: PingBytes, parsed_bytes: list[int], other: dict[str, Any]
) -> None:
    both, data = Both(), ping_bytes(2)
    both.receive(ping_bytes(1), 0, framed=False)
    both.driver.feed(data[:1000], 1)
    both.mine.feed(data[:1000], 1, framing=both.driver.framing._replace(**other))
    parsed_bytes.clear()
    both.driver.feed(data[1000:], 2)
    assert len(both.mine.feed(data[1000:], 2, framing=both.driver.framing)) == 1
    assert parsed_bytes == [len(data) - 1000]


def test_a_parser_that_is_lost_does_not_follow(ping_bytes: PingBytes) -> None:
    both, data = Both(), ping_bytes(1)
    both.receive(data, 0)
    both.driver.finish()
    both.receive(data[:1000], 1, gap=True)
    assert both.mine._next is None
    both.receive(data[1000:], 2)
    assert both.mine._next == 2 * len(data)


def test_a_connection_may_end_without_a_gap(ping_bytes: PingBytes) -> None:
    for pending in (0, 1000):
        both, data = Both(), ping_bytes(2)
        both.receive(ping_bytes(1) + data[:pending], 0)
        both.driver.finish()
        both.receive(ping_bytes(3), 1)
        both.receive(ping_bytes(4), 2)
        both.finish()
        assert len(both.found) >= 2


def test_a_checkpoint_in_a_message_holds_its_bytes(ping_bytes: PingBytes) -> None:
    both, data = Both(), ping_bytes(2)
    both.receive(ping_bytes(1), 0)
    both.receive(data[:1000], 1)
    both.receive(data[1000:2000], 2)
    state = both.mine.state()
    assert state.pending == data[:2000]
    both.compare()
    both.mine = LinkParser()
    both.mine.restore(state)
    both.receive(data[2000:], 3)
    both.finish()
    assert [one.arrival_ns for one in both.found] == [0, 1]


def test_many_small_pieces_of_a_message_are_not_kept(
    ping_bytes: PingBytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_PIECES", 10)
    both, data = Both(), ping_bytes(1) + ping_bytes(2) + ping_bytes(3)
    for at in range(len(data)):
        both.receive(data[at : at + 1], at)
        assert len(both.mine._unparsed) <= 10
    assert len(both.found) == 3
    both.finish()


SMALL = {
    "image": np.full((20, 9), 83, dtype=np.uint8),  # all S
    "bearings_cdeg": np.arange(-2000, 2001, 500, dtype=np.int16),
}


def any_bytes(chance: random.Random, ping_bytes: PingBytes, number: int) -> bytes:
    """A message, or what is none."""
    ping = ping_bytes(number, **SMALL, source_id=chance.choice((7, 7, 7, 7, 8)))
    at = chance.randrange(1, len(ping))
    unknown = HEADER.pack({"message_id": 0x99, "payload_size": 50, "source_id": 7, "version": 0})
    damaged = bytearray(ping)
    damaged[10 + at % 3] ^= 1 << chance.randrange(8)  # in its size
    others = [
        encode_dummy(source_id=7),
        chance.randbytes(chance.randrange(1, 60)),
        ping[:at],
        ping[:at] + ping[at + 40 :],
        unknown + bytes(50),
        bytes(damaged),
        ping[:-2] + b"SO",  # another ping may begin inside
    ]
    return chance.choice(others) if chance.random() < 0.5 else ping


def run_any(seed: int, ping_bytes: PingBytes) -> Both:
    """Feed both noise, lost connections, skipped bytes and checkpoints at any byte."""
    chance = random.Random(seed)  # noqa: S311 for the bytes
    both, gap, left = Both(), False, b""
    share, is_clean = chance.choice((0.0, 0.1, 0.5)), chance.random() < 0.3

    def is_time(piece: bytes) -> bool:
        return chance.random() < share * len(piece) / 4000

    for number in range(150):
        left += ping_bytes(number, **SMALL) if is_clean else any_bytes(chance, ping_bytes, number)
        size = chance.choice((13, 100, 300, 1000, 4000))
        while len(left) >= size:
            piece, left = left[:size], left[size:]
            if is_time(piece):  # the connection is lost in front of it
                both.driver.finish()
                gap = gap or chance.random() < 0.9
            if is_time(piece):  # there is no room for it in the queue
                both.driver.feed(piece, number)
                gap = True
                continue
            gap = gap or is_time(piece)
            both.receive(piece, number, gap=gap, framed=not is_time(piece))
            gap = False
            if is_time(piece):
                both.compare()
            if is_time(piece):
                state = both.mine.state()
                both.mine = LinkParser()
                both.mine.restore(state)
    both.finish()
    return both


def test_messages_and_states_are_those_of_one_that_parses_all(
    ping_bytes: PingBytes, parsed_bytes: list[int]
) -> None:
    both = [run_any(seed, ping_bytes) for seed in range(8)]
    assert sum(len(one.found) for one in both) > 500
    received = sum(one.driver.stream.bytes_total for one in both)
    assert sum(parsed_bytes) < 0.9 * received  # the rest was adopted
