"""A link in simulated time, with the map stream's pacer at its beginning.

One direction has a rate and a delay, the way back the delay alone. What sends has no more on its
way than twice what the wire holds, as a TCP with BBR; the rest waits before it, known as unsent.
"""

from collections import deque
from dataclasses import dataclass

from mapperd.server.pacer import Pacer

__all__ = ["Link", "LinkShape"]

LEAST_ON_ITS_WAY = 3_000
"""Bytes: two packets."""


@dataclass(frozen=True, slots=True)
class LinkShape:
    """Bytes a second, and the delay of each direction."""

    rate: float
    delay_s: float


class Link:
    """Moves messages, and tells the pacer what becomes of them.

    Args:
        shape: of the link.
        pacer: of the connection; told of each message before it is carried.

    Attributes:
        carried: bytes so far.
    """

    def __init__(self, shape: LinkShape, pacer: Pacer) -> None:
        self.carried = 0
        self._shape, self._pacer = shape, pacer
        self._waiting: deque[bytes] = deque()
        self._sending: deque[tuple[bytes, float]] = deque()
        self._acks: deque[tuple[float, int]] = deque()
        self._free_s = 0.0
        self._used = 0
        self._round_trip_s = 2 * shape.delay_s

    @property
    def unsent(self) -> int:
        """Bytes that wait before the wire."""
        return sum(map(len, self._waiting))

    def carry(self, message: bytes) -> None:
        """Take a message."""
        self.carried += len(message)
        self._waiting.append(message)

    def step(self, now_s: float) -> list[bytes]:
        """Let time pass; returns the messages that arrive."""
        self._send(now_s)
        arrived = []
        while self._sending and self._sending[0][1] <= now_s:
            message, at_s = self._sending.popleft()
            self._used += len(message)
            self._acks.append((at_s + self._shape.delay_s, self._used))
            arrived.append(message)
        self._pacer.note_link(self.unsent, self._round_trip_s, now_s, fills=False)
        while self._acks and self._acks[0][0] <= now_s:
            if not self._pacer.note_ack(self._acks.popleft()[1], now_s):
                raise AssertionError("more arrived than was sent")
        return arrived

    def _send(self, now_s: float) -> None:
        wire = max(2 * self._shape.rate * 2 * self._shape.delay_s, LEAST_ON_ITS_WAY)
        while self._waiting:
            on_its_way = max(self._free_s - now_s, 0.0) * self._shape.rate
            if on_its_way > wire:
                return
            message = self._waiting.popleft()
            began_s = max(self._free_s, now_s)
            self._free_s = began_s + len(message) / self._shape.rate
            self._sending.append((message, self._free_s + self._shape.delay_s))
            waited_s = self._free_s - now_s + 2 * self._shape.delay_s
            self._round_trip_s += (waited_s - self._round_trip_s) / 8
