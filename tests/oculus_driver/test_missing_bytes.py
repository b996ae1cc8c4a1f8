"""Bytes missing or too many inside a ping, and gaps that a recording knows of."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oculus_driver import Message, Ping, Reject, StreamCounters, StreamParser, decode_ping, framing
from oculus_driver.encode import encode_dummy
from oculus_driver.wire import MIB, PING_RESULT_V1

MakePing = Callable[..., bytes]

MODES = pytest.mark.parametrize("confirm", [False, True], ids=["live", "confirm"])
UNCONFIRMED = frozenset({"unconfirmed_end"})


def parsed(data: bytes, *cuts: int, confirm: bool) -> tuple[list[Message], StreamCounters]:
    parser = StreamParser(confirm=confirm)
    messages: list[Message] = []
    for start, end in pairwise([0, *sorted(cuts), len(data)]):
        messages += parser.feed(data[start:end])
    messages += parser.finish()
    counters = parser.counters
    end = 0
    for message in messages:
        assert message.offset >= end
        end = message.offset + len(message.data)
        assert message.data == data[message.offset : end]
    assert counters.bytes_rejected == len(data) - sum(len(m.data) for m in messages)
    return messages, counters


def found(messages: list[Message]) -> list[bytes]:
    return [message.data for message in messages]


@pytest.fixture(scope="module")
def pings(make_ping: MakePing) -> list[bytes]:
    """Return four pings with images of noise, as in the sea, of both versions."""
    rng = np.random.default_rng(5)
    return [
        make_ping(
            ping_id=index,
            rows=60,
            version=1 + index % 2,
            image=rng.integers(0, 256, (60, 256), dtype=np.uint8),
        )
        for index in range(4)
    ]


@MODES
def test_bytes_missing_in_a_captured_ping_cost_that_ping(capture: bytes, *, confirm: bool) -> None:
    ms = [capture[start : start + 182016] for start in (0, 182016, 364032)]
    stream = ms[0] + ms[1][:60000] + ms[1][80000:] + ms[2]
    messages, counters = parsed(stream, confirm=confirm)
    assert found(messages) == [ms[0], ms[2]]
    assert counters.rejects == {"bytes_missing": 1}
    assert (counters.bytes_rejected, counters.resyncs) == (162016, 1)
    assert not counters.warnings


@pytest.mark.slow
@MODES
@pytest.mark.parametrize("length", [2, 3, 4, 5, 13, 15, 16, 17, 121, 122, 201, 202, 703, 4900])
@pytest.mark.parametrize("index", [1, 2])
def test_bytes_missing_in_a_ping_cost_that_ping(
    pings: list[bytes], length: int, index: int, *, confirm: bool
) -> None:
    broken = pings[index][:5000] + pings[index][5000 + length :]
    stream = b"".join([*pings[:index], broken, *pings[index + 1 :]])
    messages, counters = parsed(stream, confirm=confirm)
    assert found(messages) == [ping for n, ping in enumerate(pings) if n != index]
    assert counters.rejects == {"bytes_missing": 1}
    assert counters.resyncs == 1
    for step in (1, 4096):
        cuts = range(0, len(stream), step)
        assert parsed(stream, *cuts, confirm=confirm) == (messages, counters)


def test_one_byte_missing_is_noticed_while_confirming(pings: list[bytes]) -> None:
    stream = pings[0][:5000] + pings[0][5001:] + pings[1] + pings[2]
    messages, _ = parsed(stream, confirm=True)
    assert found(messages) == pings[1:3]
    messages, _ = parsed(stream, confirm=False)
    assert found(messages)[1:] == pings[2:3]


@MODES
def test_bytes_missing_in_each_ping_cost_all_but_the_last(
    pings: list[bytes], *, confirm: bool
) -> None:
    broken = b"".join(ping[:3000] + ping[4000:] for ping in pings)
    messages, counters = parsed(broken + pings[0], confirm=confirm)
    assert found(messages) == pings[:1]
    assert counters.rejects == {"bytes_missing": 4}
    assert counters.resyncs == 1


@MODES
def test_a_stream_that_ends_in_a_ping_with_another_inside_casts_doubt(
    pings: list[bytes], *, confirm: bool
) -> None:
    size = len(pings[0])
    stream = (pings[0][:5000] + pings[2])[:size]
    messages, counters = parsed(stream, confirm=confirm)
    assert [message.warnings for message in messages] == [UNCONFIRMED]
    assert counters.warnings == {"unconfirmed_end": 1}
    ping = decode_ping(messages[0])
    assert isinstance(ping, Ping)
    assert "unconfirmed_end" in ping.warnings


@MODES
def test_a_ping_in_an_image_is_no_ping_if_the_end_is_right(
    make_ping: MakePing, *, confirm: bool
) -> None:
    inner = make_ping(rows=2, beams=4)
    image = np.frombuffer(inner.ljust(256 * 10, b"x"), np.uint8).reshape(10, 256)
    outer = make_ping(rows=10, image=image)
    assert inner in outer
    messages, counters = parsed(outer + encode_dummy() + outer, confirm=confirm)
    assert [len(message.data) for message in messages] == [len(outer), 16, len(outer)]
    assert counters.bytes_rejected == 0


@pytest.mark.parametrize("fault", ["id", "version", "source", "size", "image", "table"])
def test_a_head_that_is_wrong_somewhere_is_no_ping(
    pings: list[bytes], make_ping: MakePing, fault: str
) -> None:
    place, value = {
        "id": (6, 0x22),
        "version": (8, 3),
        "source": (2, 1),
        "size": (10, 5000),
        "image": (PING_RESULT_V1.offset_of("image_size"), 77),
        "table": (PING_RESULT_V1.offset_of("beams"), 1000),
    }[fault]
    inner = bytearray(make_ping(version=1))
    struct.pack_into("<H", inner, place, value)
    outer = pings[0][:3000] + bytes(inner) + pings[0][3000 + len(inner) :]
    messages, _ = parsed(outer + b"?" * 300 + pings[1], confirm=True)
    assert found(messages) == [outer, pings[1]]
    assert [message.warnings for message in messages] == [UNCONFIRMED, frozenset()]


@MODES
@pytest.mark.parametrize("length", [1, 2, 15, 16, 17, 201, 202, 777])
def test_bytes_between_pings_cost_no_ping(
    pings: list[bytes], length: int, *, confirm: bool
) -> None:
    junk = np.random.default_rng(length).bytes(length)
    stream = pings[0] + junk + pings[1] + pings[2]
    messages, counters = parsed(stream, confirm=confirm)
    assert found(messages) == pings[:3]
    assert (counters.bytes_rejected, counters.resyncs) == (length, 1)
    first = UNCONFIRMED if confirm else frozenset()
    assert [message.warnings for message in messages] == [first, frozenset(), frozenset()]
    assert parsed(stream, *range(len(stream)), confirm=confirm) == (messages, counters)


def test_bytes_inserted_in_a_ping_cast_doubt_on_it_alone(pings: list[bytes]) -> None:
    stream = pings[0] + pings[1][:5000] + b"?" * 777 + pings[1][5000:] + pings[2]
    messages, _ = parsed(stream, confirm=True)
    assert [len(message.data) for message in messages] == [len(ping) for ping in pings[:3]]
    assert [message.warnings for message in messages] == [frozenset(), UNCONFIRMED, frozenset()]


@pytest.mark.parametrize("place", range(16))
def test_a_changed_header_casts_no_doubt_on_the_ping_before(pings: list[bytes], place: int) -> None:
    stream = bytearray(b"".join(pings))
    stream[len(pings[0]) + place] ^= 0x80
    messages, _ = parsed(bytes(stream), confirm=True)
    assert messages[0].data == pings[0]
    assert not messages[0].warnings


def test_a_whole_stream_casts_no_doubt(pings: list[bytes]) -> None:
    for end in (b"", b"S", b"SO", pings[1][:500]):
        messages, counters = parsed(b"".join(pings) + end, confirm=True)
        assert found(messages) == pings
        assert not counters.warnings


def test_a_live_ping_comes_with_its_last_byte_and_a_confirmed_one_with_the_next_header(
    pings: list[bytes],
) -> None:
    live, confirming = StreamParser(), StreamParser(confirm=True)
    assert live.feed(pings[0][:-1]) == []
    assert found(live.feed(pings[0][-1:])) == pings[:1]
    assert confirming.feed(pings[0] + pings[1][:15]) == []
    assert found(confirming.feed(pings[1][15:16])) == pings[:1]
    assert confirming.feed(pings[1][16:]) == []
    assert found(confirming.finish()) == pings[1:2]


@MODES
@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_results_do_not_depend_on_the_split(
    make_ping: MakePing, data: st.DataObject, *, confirm: bool
) -> None:
    whole = [make_ping(rows=rows, beams=4, version=rows) for rows in (1, 2)]
    head = whole[0][:4]
    piece = st.one_of(
        st.sampled_from([*whole, encode_dummy(source_id=7892), head, b"SO", b"S"]),
        st.builds(lambda n, end: whole[n][:end], st.integers(0, 1), st.integers(0, 2100)),
        st.builds(lambda n, start: whole[n][start:], st.integers(0, 1), st.integers(0, 2100)),
        st.builds(lambda cut: whole[0][:1000] + whole[0][1000 + cut :], st.integers(1, 250)),
        st.binary(max_size=40),
    )
    stream = b"".join(data.draw(st.lists(piece, max_size=8)))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=20))
    assert parsed(stream, *cuts, confirm=confirm) == parsed(stream, confirm=confirm)


@MODES
@settings(max_examples=60, deadline=None)
@given(cut=st.integers(203, 12_000), length=st.integers(2, 4900), step=st.integers(1, 20_000))
def test_no_sound_ping_is_lost_behind_missing_bytes(
    pings: list[bytes], cut: int, length: int, step: int, *, confirm: bool
) -> None:
    stream = pings[0] + pings[1][:cut] + pings[1][cut + length :] + pings[2] + pings[3]
    messages, _ = parsed(stream, *range(0, len(stream), step), confirm=confirm)
    assert found(messages) == [pings[0], *pings[2:]]


def nested(count: int, size: int, layout_size: int) -> bytes:
    """Heads of pings, back to back, each of which claims `size` bytes, and all sizes agree."""
    head = bytearray(layout_size)
    fields = PING_RESULT_V1
    struct.pack_into("<HHHHHI", head, 0, 0x4F53, 7892, 0, 0x23, 1, size - 16)
    struct.pack_into("<I", head, fields.offset_of("image_offset"), layout_size)
    struct.pack_into("<I", head, fields.offset_of("image_size"), size - layout_size)
    struct.pack_into("<I", head, fields.offset_of("message_size"), size)
    return bytes(head) * count


@pytest.mark.slow
@MODES
@pytest.mark.parametrize("tail", [b"", b"?"])
@pytest.mark.parametrize("inner", [b"", b"SO\xd4\x1e", b"SO\xd4\x1e\0\0\x23\0\1\0\0\1\0\0\0\0"])
def test_pings_in_pings_take_linear_work(
    monkeypatch: pytest.MonkeyPatch, tail: bytes, inner: bytes, *, confirm: bool
) -> None:
    calls, looked = 0, 0
    checker, starts = framing.FrameChecker.check, framing._ping_starts_at

    def judging(self: framing.FrameChecker, *arguments: Any) -> framing.FrameResult:
        nonlocal calls
        calls += 1
        return checker(self, *arguments)

    def looking(*arguments: Any) -> bool | None:
        nonlocal looked
        looked += 1
        return starts(*arguments)

    monkeypatch.setattr(framing.FrameChecker, "check", judging)
    monkeypatch.setattr(framing, "_ping_starts_at", looking)
    piece = nested(1, MIB // 4 + 1, 122)
    stream = (piece + inner * 50) * (MIB // (len(piece) + 50 * len(inner))) + tail
    parser = StreamParser(confirm=confirm)
    most = 0
    chunks = range(0, len(stream), 4096)
    for start in chunks:
        parser.feed(stream[start : start + 4096])
        most = max(most, parser.pending_bytes)
    parser.finish()
    assert calls <= len(stream) // 8 + 2 * len(chunks)
    assert looked <= len(stream) // 4 * 3
    assert most <= MIB // 4 + 1 + 202 + 4096


@MODES
def test_a_gap_costs_the_ping_that_it_cuts(pings: list[bytes], *, confirm: bool) -> None:
    parser = StreamParser(confirm=confirm)
    messages = parser.feed(pings[0] + pings[1][:5000], 1)
    messages += parser.feed(pings[2][9000:] + pings[3], 2, gap_before=True) + parser.finish()
    assert found(messages) == [pings[0], pings[3]]
    assert not any(message.warnings for message in messages)
    assert parser.counters.rejects == {"truncated": 1}
    assert parser.counters.resyncs == 1
    assert parser.counters.bytes_rejected == 5000 + len(pings[2]) - 9000


@MODES
def test_a_gap_of_one_ping_is_no_ping(pings: list[bytes], *, confirm: bool) -> None:
    parser = StreamParser(confirm=confirm)
    messages = parser.feed(pings[0][:5000])
    messages += parser.feed(pings[2][5000:] + pings[3], gap_before=True) + parser.finish()
    assert found(messages) == pings[3:]


@MODES
def test_a_gap_between_pings_costs_none(pings: list[bytes], *, confirm: bool) -> None:
    parser = StreamParser(confirm=confirm)
    messages = parser.feed(b"", gap_before=True) + parser.feed(pings[0])
    assert parser.counters.resyncs == 1
    messages += parser.feed(b"", gap_before=True)
    assert found(messages) == pings[:1]
    assert not parser.synchronised
    messages += parser.feed(b"", gap_before=True)
    assert parser.counters.resyncs == 2
    assert parser.bytes_since_lost == 0
    messages += parser.feed(pings[1]) + parser.finish()
    assert found(messages) == pings[:2]
    assert not any(message.warnings for message in messages)


def test_a_reject_names_its_ping(make_ping: MakePing) -> None:
    data = bytearray(make_ping(ping_id=1234))
    struct.pack_into("<I", data, 198, 5)
    reject = decode_ping(Message(0x23, 2, 0, 0, bytes(data), 0, None))
    assert isinstance(reject, Reject)
    assert (reject.reason, reject.ping_id) == ("size_mismatch", 1234)


@pytest.mark.parametrize(
    ("version", "size", "ping_id"), [(1, 56, None), (1, 57, 9), (2, 92, None), (2, 93, 9)]
)
def test_a_short_reject_names_its_ping_if_the_id_is_there(
    make_ping: MakePing, version: int, size: int, ping_id: int | None
) -> None:
    data = make_ping(ping_id=9, version=version)[:size]
    reject = decode_ping(Message(0x23, version, 0, 0, data, 0, None))
    assert isinstance(reject, Reject)
    assert (reject.reason, reject.ping_id) == ("short_message", ping_id)
