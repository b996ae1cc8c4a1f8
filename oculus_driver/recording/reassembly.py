"""Put the segments of one direction of a TCP connection in order. Total, and bounded."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Final, NamedTuple

MAX_HELD_BYTES: Final = 8 << 20
MAX_HELD_SEGMENTS: Final = 1 << 13
_WRAP: Final = 1 << 32
_NEAR: Final = 64 << 20
"""Bytes ahead or behind within which a segment is taken to belong to the same connection."""


class Piece(NamedTuple):
    """Bytes that are next in the stream.

    Attributes:
        arrival_ns: when they could be read: never before what precedes them. Behind a hole that
            was given up, when they came: the receiver had what the capture does not hold.
        data: one or more bytes.
        lost: bytes before these that the capture does not hold.
        gap_before: something is missing before these; how much may not be known.
    """

    arrival_ns: int | None
    data: bytes
    lost: int
    gap_before: bool


@dataclass(slots=True)
class TcpStream:
    """Segments in any order and number, each byte out once.

    Of bytes that come twice the first ones count. A hole that is not filled while 8 MiB or 8192
    segments wait behind it is given up, and the next piece says so.
    """

    _next: int | None = None  # not wrapped
    _syn: int | None = None
    _held: list[tuple[int, bytes, int | None]] = field(default_factory=list)
    _held_bytes: int = 0
    _read_ns: int | None = None
    _lost: int = 0
    _gap: bool = False

    def feed(
        self, sequence: int, payload: bytes, arrival_ns: int | None, *, syn: bool = False
    ) -> list[Piece]:
        """Take one segment and return what it makes readable, in order.

        Args:
            sequence: number of its first byte, modulo 2³².
            payload: may be empty, repeat what was there, or end early.
            arrival_ns: when it was captured.
            syn: a connection starts here; its own mark counts as one byte.
        """
        pieces: list[Piece] = []
        start = self._unwrapped(sequence)
        if syn:
            if sequence != self._syn:
                pieces += self._restart(sequence + 1)
            self._syn = sequence
            start = self._unwrapped(sequence + 1)
        elif self._next is None or abs(start - self._next) > _NEAR:
            pieces += self._restart(sequence)
            start = sequence
        if payload:
            pieces += self._place(start, payload, arrival_ns)
        return pieces

    def flush(self) -> list[Piece]:
        """Give up all holes and return what waits behind them."""
        pieces: list[Piece] = []
        while self._held:
            pieces += self._jump()
        return pieces

    def _unwrapped(self, sequence: int) -> int:
        if self._next is None:
            return sequence
        return self._next + (sequence - self._next + _WRAP // 2) % _WRAP - _WRAP // 2

    def _restart(self, start: int) -> list[Piece]:
        pieces = self.flush()
        self._gap = self._next is not None
        self._next = start
        return pieces

    def _place(self, start: int, payload: bytes, arrival_ns: int | None) -> list[Piece]:
        if self._next is not None and start > self._next:
            self._hold(start, payload, arrival_ns)
            full = self._held_bytes > MAX_HELD_BYTES or len(self._held) > MAX_HELD_SEGMENTS
            return self._jump() if full else []
        return self._take(start, payload, arrival_ns) + self._drain()

    def _hold(self, start: int, payload: bytes, arrival_ns: int | None) -> None:
        at = bisect_left(self._held, start, key=lambda held: held[0])
        if at < len(self._held) and self._held[at][0] == start:
            if len(self._held[at][1]) >= len(payload):
                return
            self._held_bytes -= len(self._held.pop(at)[1])
        self._held.insert(at, (start, payload, arrival_ns))
        self._held_bytes += len(payload)

    def _jump(self) -> list[Piece]:
        """Go on behind the first hole."""
        start = self._held[0][0]
        self._lost += start - (self._next or start)
        self._next = start
        self._gap = True
        return self._drain()

    def _drain(self) -> list[Piece]:
        pieces: list[Piece] = []
        while self._held and self._next is not None and self._held[0][0] <= self._next:
            start, payload, arrival_ns = self._held.pop(0)
            self._held_bytes -= len(payload)
            pieces += self._take(start, payload, arrival_ns)
        return pieces

    def _take(self, start: int, payload: bytes, arrival_ns: int | None) -> list[Piece]:
        """Return the part of a segment that is new; it starts no later than what is next."""
        known = (self._next or start) - start
        data = payload[known:] if known else payload
        if not data:
            return []
        self._next = start + len(payload)
        if arrival_ns is not None:
            self._read_ns = max(arrival_ns, self._read_ns or arrival_ns)
        piece = Piece(self._read_ns, data, self._lost, self._gap)
        self._lost, self._gap = 0, False
        return [piece]
