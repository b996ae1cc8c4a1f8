"""Reassembles one direction of a TCP connection. Never raises; memory is bounded."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Final, NamedTuple

MAX_HELD_BYTES: Final = 8 << 20
MAX_HELD_SEGMENTS: Final = 1 << 13
_WRAP: Final = 1 << 32
_NEAR: Final = 64 << 20
"""Maximum distance in bytes between segments of the same connection."""


class Piece(NamedTuple):
    """The next bytes of the stream.

    Attributes:
        arrival_ns: when the bytes became readable: never before the preceding bytes. Behind an
            abandoned gap, their own arrival: the receiver had the bytes missing in the capture.
        data: one or more bytes.
        lost: number of missing bytes before these.
        gap_before: bytes are missing before these; their number may be unknown.
    """

    arrival_ns: int | None
    data: bytes
    lost: int
    gap_before: bool


@dataclass(slots=True)
class TcpStream:
    """Accepts segments in any order and number, and returns each byte once.

    Of repeated bytes the first ones count. A gap is abandoned once 8 MiB or 8192 segments wait
    after it; the next piece reports it.
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
        """Add one segment and return the bytes that it makes readable, in order.

        Args:
            sequence: number of its first byte, modulo 2³².
            payload: may be empty, truncated or repeated.
            arrival_ns: capture time.
            syn: a connection starts here; SYN counts as one byte.
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
        """Abandon all gaps and return the bytes after them."""
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
        """Continue after the first gap."""
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
        """Return the new part of a segment that starts no later than the next byte."""
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
