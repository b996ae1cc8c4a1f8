"""When a client is told of what is near the vehicle, and when of the rest of the map.

A link that is always full is a slow one: each packet waits behind others, and the same blocks are
told again and again as they change. So what is near is told in passes, each block once, with a rest
between two of them; what is far goes in the rests, and only as much as delays no pass.
"""

from dataclasses import dataclass
from math import inf

from mapperd.server.pacer import FIRST_RATE, Pacer

__all__ = ["Rooms", "Turns"]

DUTY, LONGEST_REST_S = 0.6, 0.6
"""A pass and the rest after it take so long that the link was busy for this part of the time with
what is near; and no longer than that."""

ASIDE_S = 0.15
"""Of what the link delivers, in a message about what is far."""

IDLE = 0.4
"""Of what the wire holds: no more is under way when such a message is sent."""

QUIET_S = 2.0
"""So long after the last pass the link is for what is far alone."""

EACH = 8
"""After so many messages about what is near a far one may follow, however much is left."""

SHARE = 0.9
"""Of the window: a pose never waits for the map to be acknowledged."""

LEAST = 600
"""Bytes of a message: blocks take less room the more of them are in one."""


@dataclass(frozen=True, slots=True)
class Rooms:
    """Bytes that may be told of the map now; 0 is nothing."""

    near: int = 0
    far: int = 0

    def __bool__(self) -> bool:
        return bool(self.near or self.far)


class Turns:
    """Of one client; whoever calls says what time it is.

    Args:
        pacer: of its connection.

    Attributes:
        pacer: as given; of another connection where the client is told on that one.
        beside: of the one on which it is not told, over the same link; None without one.
    """

    def __init__(self, pacer: Pacer) -> None:
        self.pacer = pacer
        self.beside: Pacer | None = None
        self._began_s: float | None = None
        self._bytes = self._messages = 0
        self._rests_until_s = 0.0
        self._near_s: float | None = None

    def rooms(self, now_s: float, most: float = inf) -> Rooms:
        """What may be told now, and no more than `most` bytes."""
        pacer = self.pacer
        free = int(pacer.window * SHARE) - pacer.in_flight
        room = int(min(free, pacer.room(now_s) * SHARE, most))
        if room < max(LEAST, SHARE * pacer.least()):
            return Rooms()
        near = room if now_s >= self._rests_until_s else 0
        if self._near_s is None or now_s - self._near_s > QUIET_S:
            return Rooms(near, room)
        rate = self._rate()
        wire = rate * (ASIDE_S + (pacer.round_trip_s or 0.0))
        in_flight = pacer.in_flight + (self.beside.in_flight if self.beside else 0)
        is_idle = in_flight <= IDLE * wire or self._messages >= EACH
        return Rooms(near, min(room, max(LEAST, int(ASIDE_S * rate))) if is_idle else 0)

    @property
    def in_pass(self) -> bool:
        """What is near has been told in part."""
        return self._began_s is not None

    def hurry(self) -> None:
        """There is something near that cannot wait."""
        self._rests_until_s = 0.0

    def told_near(self, size: int, left: int, now_s: float) -> None:
        """A message of so many bytes about what is near; so many blocks are left of the pass."""
        self._near_s = now_s
        if self._began_s is None:
            self._began_s = now_s
        self._bytes += size
        self._messages += 1
        if not left:
            self.end_pass()

    def end_pass(self) -> None:
        """Nothing is left of it, told or not: the vehicle may have gone on."""
        if self._began_s is not None:
            rest_s = min(self._bytes / (DUTY * self._rate()), LONGEST_REST_S)
            self._rests_until_s = self._began_s + rest_s
            self._began_s, self._bytes, self._messages = None, 0, 0

    def told_far(self) -> None:
        """A message about what is far."""
        self._messages = 0

    def _rate(self) -> float:
        rates = [one.rate for one in (self.pacer, self.beside) if one and one.rate]
        rate = max(rates, default=FIRST_RATE)
        limit = self.pacer.bytes_per_s
        return min(rate, limit) if limit else rate
