"""What clients whose connection broke were told, kept for a while: they go on where they were."""

import hmac
from collections import Counter, deque
from dataclasses import dataclass, field

from mapperd.server.source_protocol import MapView, Source
from mapperd.wire.messages import Interest, Resume

__all__ = ["Ends", "Parting", "ResumeCache", "is_ticket"]

PARKED_S = 120.0
MAX_ENDS = 4096


class Ends:
    """Where on a connection messages about the map end, until they are acknowledged."""

    def __init__(self) -> None:
        self._settled = self._from = 0
        self._ends: deque[tuple[int, int]] = deque(maxlen=MAX_ENDS)

    def begin(self, number: int, sent: int) -> None:
        """What has the last message of this number is told from here on."""
        self._settled, self._from = number, sent
        self._ends.clear()

    def note(self, number: int, sent: int) -> None:
        """This message ends at a byte."""
        self._ends.append((sent, number))

    def settled(self, acked: int) -> int:
        """The last message that was acknowledged whole."""
        while self._ends and self._ends[0][0] <= acked:
            self._settled = self._ends.popleft()[1]
        return self._settled

    def number_at(self, used: int) -> int | None:
        """The last message that whoever used so many bytes has; None is none that is known."""
        if used < self._from:
            return None
        return max((number for end, number in self._ends if end <= used), default=self._settled)


@dataclass(frozen=True, slots=True)
class Parting:
    """How a client's connection was when it broke.

    Attributes:
        ticket: of it.
        acked, sent: bytes of it.
        ends: of its messages about the map.
        before: what the client showed when it came. Who may never have seen the welcome shows it
            again.
    """

    ticket: str
    acked: int
    sent: int
    ends: Ends
    before: Resume | None = None

    def number_at(self, resume: Resume) -> int | None:
        """The last message that the client has; None where it cannot be as it says."""
        if is_ticket(resume.ticket, self.ticket):
            return self.ends.number_at(resume.bytes) if self._may_have(resume.bytes) else None
        return self.ends.number_at(0)

    def is_of(self, resume: Resume) -> bool:
        """Whether this is the client's."""
        if is_ticket(resume.ticket, self.ticket):
            return True
        before = self.before
        if before is None or self.acked:
            return False
        return is_ticket(resume.ticket, before.ticket) and before.bytes == resume.bytes

    def _may_have(self, used: int) -> bool:
        return self.acked <= used <= self.sent


@dataclass(slots=True)
class _Parked:
    view: MapView
    parting: Parting
    since_s: float


@dataclass(slots=True)
class ResumeCache:
    """Of one server; of the thread of its map. Whoever calls says what time it is.

    Args:
        most: clients; the oldest goes for one more.

    Attributes:
        counters: `parked`, `parked_resumed`, `parked_dropped`: how often.
    """

    most: int
    counters: Counter[str] = field(
        default_factory=lambda: Counter(parked=0, parked_resumed=0, parked_dropped=0)
    )
    _parked: list[_Parked] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._parked)

    def park(self, view: MapView, parting: Parting, now_s: float) -> None:
        """A client is lost; its view goes on listening."""
        self.counters["parked"] += 1
        self._parked.append(_Parked(view, parting, now_s))
        while len(self._parked) > self.most:
            self._drop(self._parked[0])

    def expire(self, now_s: float) -> None:
        """Forget whoever does not come back."""
        while self._parked and now_s - self._parked[0].since_s > PARKED_S:
            self._drop(self._parked[0])

    def take(self, resume: Resume, interest: Interest, source: Source) -> MapView | None:
        """The view of a client that comes back, once; None where it cannot go on."""
        found = [one for one in self._parked if one.parting.is_of(resume)]
        if not found:
            return None
        one = found[0]
        number = one.parting.number_at(resume)
        held = (resume.level, resume.detail, resume.radius_m, resume.box)
        is_same = (
            resume.map == source.facts().id
            and resume.session == source.session
            and held == (interest.level, interest.detail, interest.radius_m, interest.box)
        )
        if number is None or not is_same or not one.view.go_on(interest, number):
            self._drop(one)
            return None
        self._parked.remove(one)
        self.counters["parked_resumed"] += 1
        return one.view

    def _drop(self, one: _Parked) -> None:
        self._parked.remove(one)
        self.counters["parked_dropped"] += 1
        one.view.close()


def is_ticket(shown: str, ticket: str) -> bool:
    """Whether a client knows it; takes as long whatever it shows."""
    return bool(shown) and hmac.compare_digest(shown.encode(), ticket.encode())
