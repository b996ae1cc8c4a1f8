"""One quantity from its one owner: whose it is, what of it is believed, and where it jumps."""

from collections import Counter
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd.odometry.jump import JumpWatch
from mapperd.odometry.series import Series
from mapperd.reject import Reject

__all__ = ["AUTO", "Owner", "Track"]

V = TypeVar("V")
Floats = NDArray[np.float64]
Owner = tuple[str, str]
"""Name of the source, and of the sender on it."""

AUTO = ""
"""As a configured owner: the first source that says it."""

TAKE_OVER_NS = 2_000_000_000
"""So long a sender is silent before another one on the same source takes its place."""

ANEW_NS = 1_000_000_000
ANEW_RECORDS = 10
"""So many records in a row, in order, and all so much before the newest one: the host's clock was
set back, or a stamp far ahead was believed. Without this nothing would be taken any more."""


class Track(Generic[V]):
    """A series with an owner.

    Args:
        owner: configured name of the source, or `AUTO`.
        excess: see `mapperd.odometry.jump.JumpWatch`; None is of a quantity that may jump.

    Attributes:
        series: what was taken.
        segment: counts up where the quantity jumped.
        owner: who says it; None while nobody has.
        taken: records that were used.
        rejects: reason to count, of the owner's records that were not.
    """

    def __init__(
        self, owner: str, excess: Callable[[Floats, Floats, float], float] | None = None
    ) -> None:
        self._named = owner
        self._watch = None if excess is None else JumpWatch(excess)
        self._reset_count: int | None = None
        self._taken_over = False
        self._behind: tuple[int, int] = (0, 0)  # records, time of the last of them
        self.series: Series[V] = Series()
        self.segment = 0
        self.owner: Owner | None = None
        self.taken = 0
        self.rejects: Counter[str] = Counter()

    def owned_by(self, who: Owner, t_ns: int) -> bool:
        """Whether a source may say this quantity; the first that may owns it.

        Another sender on the owner's own source takes over once that is silent: a bridge that was
        started again under another name.
        """
        if self.owner is None and self.open_to(who):
            self.owner = who
        elif self.owner is not None and self.owner != who and self.owner[0] == who[0]:
            newest = self.series.newest
            if newest is None or t_ns - newest.t_ns > TAKE_OVER_NS:
                self.owner, self._taken_over = who, True
        return self.owner == who

    def open_to(self, who: Owner) -> bool:
        """Whether the settings let a source say this quantity."""
        return self._named in (AUTO, who[0])

    def judge(self, t_ns: int, raw: Floats, reset_count: int) -> Reject | bool:
        """Whether a value can be taken.

        Args:
            t_ns: host time.
            raw: in the source's own frame, before any anchor.
            reset_count: the source's.

        Returns:
            Why not, else whether a new segment begins with it.
        """
        if (problem := self.series.problem(t_ns)) is not None:
            if not self._begins_anew(t_ns):
                return problem
            self.series.clear()
            if self._watch is not None:
                self._watch.moved(t_ns, raw)
            self._reset_count = reset_count
            return True
        self._behind = (0, 0)
        jumped: bool | None = self._taken_over
        if self._watch is not None:
            if self._taken_over or self._reset_count not in (None, reset_count):
                self._watch.moved(t_ns, raw)
                jumped = True
            else:
                jumped = self._watch.check(t_ns, raw)
        if jumped is None:
            return Reject("jump", "it does not follow from the record before")
        self._reset_count, self._taken_over = reset_count, False
        return jumped

    def _begins_anew(self, t_ns: int) -> bool:
        newest, (records, last_ns) = self.series.newest, self._behind
        if newest is None or newest.t_ns - t_ns < ANEW_NS:
            return False
        self._behind = (records + 1 if t_ns > last_ns else 1, t_ns)
        return self._behind[0] >= ANEW_RECORDS

    def take(self, t_ns: int, value: V, *, jumped: bool) -> None:
        """Follow a value that was judged good."""
        self.segment += jumped
        self.taken += 1
        self.series.add(t_ns, value, self.segment)

    def counted(self, result: Reject | None) -> Reject | None:
        """Count what became of the owner's value, and hand it on."""
        if result is not None:
            self.rejects[result.reason] += 1
        return result

    def status(self) -> dict[str, Any]:
        """For a person: owner, counts, time of the newest value."""
        newest = self.series.newest
        return {
            "owner": None if self.owner is None else self.owner[0],
            "sender": None if self.owner is None else self.owner[1],
            "taken": self.taken,
            "rejected": dict(self.rejects),
            "segment": self.segment,
            "newest_ns": None if newest is None else newest.t_ns,
        }
