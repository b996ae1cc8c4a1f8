"""Segments in any order, each byte out once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.recording import network_capture
from oculus_driver.recording.network_capture import TcpStream

DATA = np.random.default_rng(3).bytes(2000)
WRAP = 1 << 32


def segment(start: int, stop: int, origin: int = 0) -> tuple[int, bytes]:
    return (origin + start) % WRAP, DATA[start:stop]


def test_segments_in_order_come_out_at_once_over_the_wrap() -> None:
    stream = TcpStream()
    origin = WRAP - 700
    assert stream.feed(origin - 1, b"", 5, syn=True) == []
    for start in range(0, 2000, 100):
        (piece,) = stream.feed(*segment(start, start + 100, origin), 10 + start)
        assert (piece.data, piece.arrival_ns) == (DATA[start : start + 100], 10 + start)
        assert (piece.lost, piece.gap_before) == (0, False)


def test_what_comes_early_waits_and_is_not_older_than_what_it_waited_for() -> None:
    stream = TcpStream()
    stream.feed(*segment(0, 100), 1)
    assert stream.feed(*segment(200, 300), 2) == []
    assert stream.feed(*segment(300, 400), 3) == []
    pieces = stream.feed(*segment(100, 200), 9)
    assert b"".join(piece.data for piece in pieces) == DATA[100:400]
    assert {piece.arrival_ns for piece in pieces} == {9}


def test_repeats_and_overlaps_give_each_byte_once() -> None:
    stream = TcpStream()
    parts = [
        (0, 100),
        (0, 100),
        (50, 150),
        (99, 100),
        (200, 260),
        (200, 300),
        (250, 280),
        (140, 210),
    ]
    out = [piece.data for part in parts for piece in stream.feed(*segment(*part), None)]
    assert b"".join(out) == DATA[:300]


@given(st.data())
def test_any_shuffle_gives_the_stream(data: st.DataObject) -> None:
    origin = data.draw(st.integers(0, WRAP - 1))
    cuts = sorted(data.draw(st.sets(st.integers(1, 1999), max_size=20)) | {0, 2000})
    parts = list(pairwise(cuts))
    parts += data.draw(st.lists(st.sampled_from(parts), max_size=10))
    stream = TcpStream()
    stream.feed((origin - 1) % WRAP, b"", 0, syn=True)
    out = b""
    for part in data.draw(st.permutations(parts)):
        pieces = stream.feed(*segment(*part, origin), 1)
        assert not any(piece.gap_before for piece in pieces)
        out += b"".join(piece.data for piece in pieces)
    assert out == DATA
    assert stream.flush() == []


def test_a_hole_that_nobody_fills_is_reported() -> None:
    stream = TcpStream()
    stream.feed(*segment(0, 100), 1)
    stream.feed(*segment(150, 200), 2)
    stream.feed(*segment(300, 400), 3)
    first, second = stream.flush()
    assert (first.arrival_ns, second.arrival_ns) == (2, 3)
    assert (first.data, first.lost, first.gap_before) == (DATA[150:200], 50, True)
    assert (second.data, second.lost, second.gap_before) == (DATA[300:400], 100, True)
    assert stream.feed(*segment(100, 150), 4) == []  # too late


def test_what_waits_is_bounded() -> None:
    stream = TcpStream()
    stream.feed(0, b"x", 1)
    for index in range(3 * network_capture.MAX_HELD_SEGMENTS):
        stream.feed(100 + 2 * index, b"y", 1)
        assert len(stream._held) <= network_capture.MAX_HELD_SEGMENTS
    stream = TcpStream()
    stream.feed(0, b"x", 1)
    out = 0
    for index in range(40):
        pieces = stream.feed(100 + (index << 20), bytes(1 << 19), 1)
        out += sum(len(piece.data) for piece in pieces)
        assert stream._held_bytes <= network_capture.MAX_HELD_BYTES
    assert out + stream._held_bytes == 20 << 20


def test_a_new_connection_starts_again() -> None:
    stream = TcpStream()
    stream.feed(*segment(0, 100), 1)
    stream.feed(*segment(150, 200), 1)
    (held,) = stream.feed(5000, b"", 2, syn=True)
    assert (held.data, held.gap_before) == (DATA[150:200], True)
    (piece,) = stream.feed(5001, b"new", 3)
    assert (piece.data, piece.lost, piece.gap_before) == (b"new", 0, True)
    assert stream.feed(5000, b"", 3, syn=True) == []  # the same handshake again
    (piece,) = stream.feed(5004, b"more", 4)
    assert not piece.gap_before


def test_numbers_far_away_are_another_connection() -> None:
    stream = TcpStream()
    stream.feed(*segment(0, 100), 1)
    (piece,) = stream.feed(1 << 30, b"far", 2)
    assert (piece.data, piece.lost, piece.gap_before) == (b"far", 0, True)
