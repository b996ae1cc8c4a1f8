"""The stream parser: whole, split, cut, damaged and hostile streams."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oculus_driver.encode import encode_dummy, encode_fire, encode_user_config
from oculus_driver.errors import Reject
from oculus_driver.framing import Header, header_fault
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import Message, MessageBounds, StreamCounters, StreamParser
from oculus_driver.wire import HEADER, MAGIC, MIB, MIN_PING_PAYLOAD, PING_RESULT_V2, MessageId

MakePing = Callable[..., bytes]

SIZE = 182016
STARTS = [0, SIZE, 2 * SIZE]


def header(message_id: int, payload: int, version: int = 0, source: int = 7892) -> bytes:
    return HEADER.pack(
        {
            "message_id": message_id,
            "payload_size": payload,
            "version": version,
            "source_id": source,
        }
    )


def parsed(data: bytes, *cuts: int) -> tuple[list[Message], StreamCounters]:
    """Parse a stream split at `cuts`, and check what holds for any stream."""
    parser = StreamParser()
    messages: list[Message] = []
    borders = [0, *sorted(cuts), len(data)]
    for start, end in pairwise(borders):
        messages += parser.feed(data[start:end])
    messages += parser.finish()
    counters = parser.counters
    end = 0
    for message in messages:
        assert message.offset >= end
        end = message.offset + len(message.data)
        assert message.data == data[message.offset : end]
    assert counters.bytes_total == len(data)
    assert counters.bytes_rejected == len(data) - sum(len(m.data) for m in messages)
    assert counters.messages.total() == len(messages)
    assert parser.pending_bytes == 0
    return messages, counters


def offsets(messages: list[Message]) -> list[int]:
    return [message.offset for message in messages]


@pytest.mark.parametrize(
    ("start", "found"),
    [
        (0, STARTS),
        (1, STARTS[1:]),
        (634, STARTS[1:]),
        (1000, STARTS[1:]),
        (2048, STARTS[1:]),
        (182015, STARTS[1:]),
        (182017, STARTS[2:]),
        (364033, []),
    ],
)
def test_a_stream_can_be_entered_anywhere(capture: bytes, start: int, found: list[int]) -> None:
    messages, counters = parsed(capture[start:])
    assert [start + offset for offset in offsets(messages)] == found
    first = found[0] - start if found else len(capture) - start
    assert counters.bytes_rejected == first
    assert counters.resyncs == (start > 0)
    assert counters.rejects == ({"bad_magic": 1} if start else {})


def test_a_whole_capture_leaves_nothing_over(capture: bytes) -> None:
    messages, counters = parsed(capture)
    assert offsets(messages) == STARTS
    assert counters == StreamCounters(bytes_total=546048, messages=counters.messages)
    assert counters.messages == {0x23: 3}


def test_single_bytes_give_the_same_messages(make_ping: MakePing) -> None:
    stream = b"junk" + make_ping() + encode_dummy() + make_ping(version=1)
    assert parsed(stream, *range(len(stream))) == parsed(stream)


def test_a_message_owns_its_bytes_and_has_the_stamp_of_its_first(make_ping: MakePing) -> None:
    ping = make_ping()
    stream = bytearray(ping * 3)
    parser = StreamParser()
    messages = []
    for start in range(0, len(stream), 1000):
        messages += parser.feed(memoryview(stream)[start : start + 1000], arrival_ns=start)
    stream[:] = bytes(len(stream))
    assert [message.data for message in messages] == [ping] * 3
    assert [message.arrival_ns for message in messages] == [
        offset // 1000 * 1000 for offset in (0, len(ping), 2 * len(ping))
    ]


@given(size=st.integers(1, 3000))
def test_bounds_of_any_pieces_are_those_of_the_messages(make_ping: MakePing, size: int) -> None:
    ping = make_ping()
    stream = ping + encode_dummy() + ping + b"junk" + ping * 2
    borders = (0, len(ping), len(ping) + 16, 2 * len(ping) + 16)  # up to the junk
    parser = StreamParser()
    for start in range(0, borders[-1], size):
        piece = stream[start : start + size]
        bounds = parser.bounds(parser.feed(piece), len(piece))
        if start + len(piece) > borders[-1]:
            break
        inside = [border for border in borders if start <= border < start + len(piece)]
        assert bounds.start == (inside[0] - start if inside else len(piece))
        assert bounds.end == max(b for b in borders if b <= start + len(piece)) - start


def test_bounds_skip_bytes_that_are_no_message(make_ping: MakePing) -> None:
    ping = make_ping()
    parser = StreamParser()
    piece = b"junk" * 10 + ping + ping[:50]
    assert parser.bounds(parser.feed(piece), len(piece)) == MessageBounds(40, 40 + len(ping))
    assert parser.bounds(parser.feed(ping[50:60]), 10) == MessageBounds(10, -50)


def test_stamps_follow_chunks_with_and_without_one(make_ping: MakePing) -> None:
    ping = make_ping()
    parser = StreamParser()
    found = parser.feed(b"", 1) + parser.feed(ping, None) + parser.feed(b"", 2)
    found += parser.feed(ping[:5], 3) + parser.feed(b"", 9) + parser.feed(ping[5:], 4)
    assert [message.arrival_ns for message in found] == [None, 3]


def test_a_stamp_for_each_byte_needs_little_memory(make_ping: MakePing) -> None:
    parser = StreamParser()
    stream = make_ping(rows=600) + make_ping()
    found = []
    for index in range(len(stream)):
        found += parser.feed(stream[index : index + 1], index)
    assert found[0].arrival_ns == 0
    assert len(parser._stamps) < 1 << 16


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("change", [0x01, 0x02, 0x80, 0xFF])
@pytest.mark.parametrize("place", range(16))
def test_a_changed_header_byte_costs_at_most_its_ping(
    capture: bytes, index: int, change: int, place: int
) -> None:
    stream = bytearray(capture)
    stream[STARTS[index] + place] ^= change
    messages, counters = parsed(bytes(stream))
    lost = place in (0, 1, 9) or (place == 13)
    assert offsets(messages) == [start for start in STARTS if not (lost and start == STARTS[index])]
    assert counters.bytes_rejected == SIZE * lost
    assert counters.resyncs == lost
    whole = sum(isinstance(decode_ping(message), Ping) for message in messages)
    harmless = place in (2, 3, 4, 5, 14, 15) or (place == 8 and change == 1)
    assert whole == (3 if harmless else 2)
    expected = {0: "bad_magic", 1: "bad_magic", 9: "unknown_version", 13: "oversize"}.get(place)
    if place in (6, 7) and stream[STARTS[index] + 6 : STARTS[index] + 8] != b"\x22\0":
        expected = "unknown_id"
    assert counters.rejects == ({expected: 1} if expected else {})
    mismatches = {0: 1, 1: 2, 2: 1}[index]
    assert counters.warnings == ({"source_mismatch": mismatches} if place in (2, 3) else {})


@pytest.mark.parametrize("claim", [0, 50, 106, 107, 5000, SIZE - 17, SIZE - 15, SIZE, 16 * MIB])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_damaged_size_costs_one_ping(capture: bytes, index: int, claim: int) -> None:
    stream = bytearray(capture)
    struct.pack_into("<I", stream, STARTS[index] + 10, claim)
    messages, counters = parsed(bytes(stream))
    assert offsets(messages) == STARTS
    assert counters.bytes_rejected == 0
    results = [decode_ping(message) for message in messages]
    assert isinstance(results.pop(index), Reject)
    assert all(isinstance(result, Ping) for result in results)


def test_two_damaged_sizes_cost_the_ping_and_not_those_it_claims(capture: bytes) -> None:
    stream = bytearray(capture)
    struct.pack_into("<I", stream, 10, 400_000)
    struct.pack_into("<I", stream, 118, 5)
    messages, counters = parsed(bytes(stream))
    assert offsets(messages) == STARTS[1:]
    assert counters.rejects == {"size_mismatch": 1}
    assert counters.bytes_rejected == SIZE


def test_a_ping_with_odd_sizes_that_is_followed_by_another_stays_in_step(capture: bytes) -> None:
    stream = bytearray(capture)
    struct.pack_into("<I", stream, 118, 5)
    messages, counters = parsed(bytes(stream))
    assert offsets(messages) == STARTS
    assert counters.resyncs == 0
    assert isinstance(decode_ping(messages[0]), Reject)


@pytest.mark.parametrize("length", [1, 2, 15, 16, 17, 1000])
def test_inserted_bytes_cost_nothing_but_themselves(capture: bytes, length: int) -> None:
    junk = np.random.default_rng(length).bytes(length)
    messages, counters = parsed(capture[:SIZE] + junk + capture[SIZE:])
    assert offsets(messages) == [0, SIZE + length, 2 * SIZE + length]
    assert (counters.bytes_rejected, counters.resyncs) == (length, 1)


@pytest.mark.parametrize("place", [17, 300, 634, 2048, 100_000, SIZE - 1])
def test_bytes_inserted_in_a_ping_leave_the_others(capture: bytes, place: int) -> None:
    messages, counters = parsed(capture[:place] + b"?????" + capture[place:])
    assert offsets(messages)[-2:] == [SIZE + 5, 2 * SIZE + 5]
    assert counters.resyncs == 1


@pytest.mark.parametrize("cut", [1, 2, 15, 16, 121, 122, 700, 2048, SIZE - 1])
def test_a_stream_that_ends_in_a_message_is_truncated(capture: bytes, cut: int) -> None:
    messages, counters = parsed(capture[: SIZE + cut])
    assert offsets(messages) == [0]
    assert counters.rejects == {"truncated": 1}
    assert (counters.bytes_rejected, counters.resyncs) == (cut, 0)


def test_a_stream_goes_on_after_its_end_was_settled(make_ping: MakePing) -> None:
    ping = make_ping()
    parser = StreamParser()
    assert parser.feed(ping[:-1]) == parser.finish() == []
    (message,) = parser.feed(ping)
    assert message.offset == len(ping) - 1


def test_a_message_cut_off_hides_nothing_behind_it(make_ping: MakePing) -> None:
    ping = make_ping()
    messages, counters = parsed(header(0x80, 60_000) + ping)
    assert offsets(messages) == [16]
    assert counters.rejects == {"truncated": 1}


def test_messages_that_are_no_pings_come_through(make_ping: MakePing) -> None:
    stream = (
        encode_dummy()
        + header(0x80, 5)
        + b"hello"
        + encode_user_config()
        + encode_fire()
        + header(0x22, 700)
        + bytes(700)
        + make_ping()
    )
    messages, counters = parsed(stream)
    assert [message.message_id for message in messages] == [0xFF, 0x80, 0x55, 0x15, 0x22, 0x23]
    assert messages[1].data[16:] == b"hello"
    assert counters.bytes_rejected == 0


def test_a_sign_of_life_is_not_held_back() -> None:
    parser = StreamParser()
    assert len(parser.feed(encode_dummy())) == 1
    assert len(parser.feed(header(0x80, 5) + b"hello")) == 1


def test_unknown_messages_are_skipped_and_counted(make_ping: MakePing) -> None:
    ping = make_ping()
    stream = ping + header(0x77, 1000, version=200) + bytes(1000) + ping
    messages, counters = parsed(stream)
    assert [message.message_id for message in messages] == [0x23, 0x77, 0x23]
    assert counters.rejects == {"unknown_id": 1}
    assert counters.resyncs == 0


def test_an_unknown_message_of_the_largest_size_is_skipped(make_ping: MakePing) -> None:
    messages, counters = parsed(header(0x77, MIB) + bytes(MIB) + make_ping())
    assert offsets(messages) == [0, 16 + MIB]
    assert counters.bytes_rejected == 0


def test_an_unknown_message_that_leads_nowhere_hides_no_ping(make_ping: MakePing) -> None:
    ping = make_ping()
    messages, counters = parsed(ping + header(0x77, 1 << 20) + ping * 3)
    assert offsets(messages) == [0, *(len(ping) * n + 16 for n in (1, 2, 3))]
    assert counters.bytes_rejected == 16


@pytest.mark.parametrize(
    ("message_id", "limit"),
    [(0x15, 4096), (0x23, 16 * MIB), (0x55, 64), (0x80, 65536), (0xFF, 4096), (0x77, MIB)],
)
def test_sizes_over_the_limit_are_not_waited_for(
    make_ping: MakePing, message_id: int, limit: int
) -> None:
    for claim in (limit + 1, 2**32 - 1):
        parser = StreamParser()
        (message,) = parser.feed(header(message_id, claim) + make_ping())
        assert message.offset == 16
        assert parser.counters.rejects == {"oversize": 1}


def test_while_resynchronising_unknown_ids_are_not_believed(make_ping: MakePing) -> None:
    ping = make_ping()
    messages, _ = parsed(b"x" + header(0x77, 100) + bytes(100) + ping)
    assert [message.message_id for message in messages] == [0x23]


def test_while_resynchronising_a_dummy_needs_a_message_behind_it(make_ping: MakePing) -> None:
    ping = make_ping()
    messages, _ = parsed(b"x" + encode_dummy(source_id=7892) + ping)
    assert [message.message_id for message in messages] == [0xFF, 0x23]
    messages, _ = parsed(b"x" + encode_dummy(source_id=7892) + b"yy" + ping)
    assert [message.message_id for message in messages] == [0x23]


def test_while_resynchronising_another_source_must_be_seen_twice(make_ping: MakePing) -> None:
    ours, theirs = make_ping(), make_ping(source_id=1)
    messages, _ = parsed(ours + b"x" + theirs + ours)
    assert [message.source_id for message in messages] == [7892, 7892]
    messages, _ = parsed(ours + b"x" + theirs * 3)
    assert [message.source_id for message in messages] == [7892, 1, 1, 1]
    parser = StreamParser(source_id=1)
    assert offsets(parser.feed(b"x" + ours + theirs)) == [1 + len(ours)]


def test_while_resynchronising_a_table_inside_the_image_proves_nothing(make_ping: MakePing) -> None:
    ping = bytearray(make_ping())
    struct.pack_into("<H", ping, PING_RESULT_V2.offset_of("beams"), 1000)
    messages, _ = parsed(b"x" + bytes(ping) + b"y" * 40 + make_ping())
    assert offsets(messages) == [1 + len(ping) + 40]


def test_an_unknown_version_is_skipped_in_step(make_ping: MakePing) -> None:
    strange = bytearray(make_ping())
    strange[8] = 3
    messages, counters = parsed(bytes(strange) + make_ping())
    results = [decode_ping(message) for message in messages]
    assert isinstance(results[0], Reject)
    assert results[0].reason == "unknown_version"
    assert isinstance(results[1], Ping)
    assert counters.bytes_rejected == 0


def test_the_state_can_be_watched(make_ping: MakePing) -> None:
    parser = StreamParser()
    ping = make_ping()
    assert (parser.synchronised, parser.source_id, parser.bytes_since_lost) == (True, None, 0)
    parser.feed(ping + b"x" * 100)
    assert (parser.synchronised, parser.source_id) == (False, 7892)
    assert parser.bytes_since_lost == 100
    parser.feed(ping + ping[:50])
    assert (parser.synchronised, parser.pending_bytes, parser.bytes_since_lost) == (True, 50, 0)


def pieces(make_ping: MakePing) -> st.SearchStrategy[bytes]:
    ping = make_ping(rows=2, beams=4)
    long_claim = bytearray(ping)
    struct.pack_into("<I", long_claim, 10, 2 * len(ping))
    return st.one_of(
        st.sampled_from(
            [
                ping,
                make_ping(rows=1, beams=2, version=1),
                bytes(long_claim),
                encode_dummy(source_id=7892),
                header(0x80, 5) + b"hello",
                header(0x77, 40) + bytes(40),
                header(0x77, 3000),
                header(0x22, 16 * MIB),
                ping[:700],
                ping[5:],
                b"SO",
                b"S",
            ]
        ),
        st.binary(max_size=40),
        st.builds(lambda place, value: ping[:place] + bytes([value]) + ping[place + 1 :],
                  st.integers(0, 201), st.integers(0, 255)),
    )  # fmt: skip


@settings(max_examples=200)
@given(data=st.data())
def test_messages_and_counters_do_not_depend_on_the_split(
    make_ping: MakePing, data: st.DataObject
) -> None:
    stream = b"".join(data.draw(st.lists(pieces(make_ping), max_size=8)))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=20))
    assert parsed(stream, *cuts) == parsed(stream)


@given(data=st.data())
def test_sound_pings_between_anything_small_are_found(
    make_ping: MakePing, data: st.DataObject
) -> None:
    ping = make_ping(rows=2, beams=4)
    junk = data.draw(st.lists(st.binary(max_size=30).filter(lambda b: b"S" not in b), max_size=5))
    messages, counters = parsed(b"".join(piece + ping for piece in junk))
    assert [message.data for message in messages] == [ping] * len(junk)
    assert counters.bytes_rejected == sum(map(len, junk))


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=5))
def test_any_bytes_are_parsed(stream: bytes, cuts: list[int]) -> None:
    assert parsed(stream, *(min(cut, len(stream)) for cut in cuts)) == parsed(stream)


def test_a_ping_too_short_for_one_is_invalid_while_the_place_is_in_doubt() -> None:
    least = Header(MAGIC, 1, 0, MessageId.PING_RESULT, 2, MIN_PING_PAYLOAD, 0)
    assert header_fault(least, strict=True) is None
    short = least._replace(payload_size=MIN_PING_PAYLOAD - 1)
    assert header_fault(short, strict=True) == "short_message"
    assert header_fault(short, strict=False) is None
