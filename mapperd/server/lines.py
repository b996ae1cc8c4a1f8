"""On which of a client's two connections it is told of the map.

TCP gives in order: a packet that it loses holds up all that comes behind, a round trip for each
time that it is lost. What is told of the map may come in any order, so on a link that is far away
and loses packets a client may have a second connection.

- A pass over what is near begins on the line where nothing is overdue.
- A line on which something was lost more than once is held up: what was under way on it, and is
  near the vehicle, is told again on the other one. To tell again whatever was lost once would fill
  the link.
"""

from math import inf

from mapperd.server.pacer import LEAST_WINDOW, LOSS_S, Pacer
from mapperd.server.source_protocol import FIRST, SECOND, Line

__all__ = ["Lines"]

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
        calm = max(rate * (trip_s + CALM_S), LEAST_WINDOW)
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
