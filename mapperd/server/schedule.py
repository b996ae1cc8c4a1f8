"""When, and on which of its connections, a client gets which part of the map.

A link that is always full is a slow one: each packet waits behind others, and the same blocks are
told again and again as they change. So what is near is told in passes, each block once, with a rest
between two of them; what is far goes in the rests, and only as much as delays no pass.

On which of a client's two connections it is told of the map.

TCP gives in order: a packet that it loses holds up all that comes behind, a round trip for each
time that it is lost. What is told of the map may come in any order, so on a link that is far away
and loses packets a client may have a second connection.

- A pass over what is near begins on the line where nothing is overdue.
- A line on which something was lost more than once is held up: what was under way on it, and is
  near the vehicle, is told again on the other one. To tell again whatever was lost once would fill
  the link.
"""

from dataclasses import dataclass
from math import inf

from mapperd.server.pacer import FIRST_RATE, LOSS_S, MIN_WINDOW, Pacer
from mapperd.server.source_protocol import FIRST, SECOND, Line

__all__ = ["Lines", "Rooms", "Turns"]

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

MIN = 600
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
        if room < max(MIN, SHARE * pacer.least()):
            return Rooms()
        near = room if now_s >= self._rests_until_s else 0
        if self._near_s is None or now_s - self._near_s > QUIET_S:
            return Rooms(near, room)
        rate = self._rate()
        wire = rate * (ASIDE_S + (pacer.round_trip_s or 0.0))
        in_flight = pacer.in_flight + (self.beside.in_flight if self.beside else 0)
        is_idle = in_flight <= IDLE * wire or self._messages >= EACH
        return Rooms(near, min(room, max(MIN, int(ASIDE_S * rate))) if is_idle else 0)

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


SLACK_S = 0.2
"""Beyond two round trips: what was lost once is acknowledged by then, what was lost twice not."""

IN_TIME, OVERDUE, BLOCKED, HELD_UP = range(4)
"""What a line was given: acknowledged in time so far; later than if nothing was lost; not even
sent, as BBR pauses for a round trip or two each 10 s; lost more than once."""

BLOCKED_S = 0.15

CALM_S = 0.2
"""That packets may wait in the network."""

FAR_S, STALLS = 0.1, 3
"""A round trip of so long, and so often something that was late, make a second line worth it."""


class Lines:
    """Of one client; whoever calls says what time it is.

    Args:
        first: of the connection that is there from the beginning.

    Attributes:
        line: on which the map is told.
    """

    def __init__(self, first: Pacer) -> None:
        self.line: Line = FIRST
        self._first = first
        self._second: Pacer | None = None
        self._is_advised = False
        self._told_again: set[Line] = set()

    @property
    def advised(self) -> bool:
        """Whether a second line is worth it; once it is, it stays so."""
        first = self._first
        self._is_advised |= first.stalls >= STALLS and (first.round_trip_s or 0.0) >= FAR_S
        return self._is_advised

    def join(self, second: Pacer) -> None:
        """There is a second line; it shares the client's budget."""
        second.budget = self._first.budget
        self._second, self.line = second, FIRST
        self._told_again.clear()

    def part(self) -> None:
        """It is gone."""
        self._second, self.line = None, FIRST

    def choose(self, now_s: float, *, in_pass: bool) -> Line | None:
        """Choose the line.

        Args:
            now_s: now.
            in_pass: the line stays the same, unless it is blocked or held up.

        Returns:
            one on which what is near and under way is to be told again on the other; None is none.
        """
        if self._second is None:
            return None
        waits = [self._waits(one, now_s) for one in (self._first, self._second)]
        other = SECOND if self.line == FIRST else FIRST
        if waits[other] < waits[self.line] and (not in_pass or waits[self.line] >= BLOCKED):
            self.line, other = other, self.line
        self._told_again = {line for line in self._told_again if waits[line] == HELD_UP}
        if waits[self.line] < waits[other] == HELD_UP and other not in self._told_again:
            self._told_again.add(other)
            return other
        return None

    def calm_room(self) -> float:
        """Bytes of the map that may be sent so that packets hardly wait for others.

        TCP itself sends more: to see what the link takes, and each connection for itself. What it
        says of the rate does not become less by sending less, or this would never end.
        """
        lines = [self._first] if self._second is None else [self._first, self._second]
        # What it says before the link was ever busy is of a few small packets.
        rate = max((one.link_rate or 0.0 for one in lines if one.rate is not None), default=0.0)
        trip_s = self._first.round_trip_s
        if not rate or trip_s is None:
            return inf
        calm = max(rate * (trip_s + CALM_S), MIN_WINDOW)
        return calm - sum(one.in_network for one in lines)

    def _waits(self, pacer: Pacer, now_s: float) -> int:
        trip_s = pacer.trip_s or self._first.trip_s
        if trip_s is None:
            return IN_TIME
        waits_s = pacer.waits_s(now_s)
        if waits_s > 2 * trip_s + SLACK_S:
            return HELD_UP
        if pacer.blocked_s(now_s) > BLOCKED_S:
            return BLOCKED
        return OVERDUE if waits_s > trip_s + LOSS_S else IN_TIME
