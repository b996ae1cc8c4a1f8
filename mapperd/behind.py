"""What waits for the map, and what happens when pings come faster than they can be mapped."""

from collections import deque
from dataclasses import dataclass

from mapperd.config_service import Behind as Policy
from mapperd.decisions import Drop, ErrorBound
from mapperd.engine import Settled, Work
from mapperd.reject import Reject

__all__ = ["Backlog", "Turn"]

MAX_BYTES = 64 * 1024 * 1024
"""Images that may wait for their turn; beyond, the oldest are dropped."""

COARSE_FROM = 0.5
"""Share of `behind.max_wait` from which on pings are mapped coarser."""

CAUGHT_UP = 0.1
"""Share of `behind.max_wait` below which all is well again."""


@dataclass(frozen=True, slots=True)
class Turn:
    """What is to be done next.

    Attributes:
        work: it is its turn, or it is dropped, as the remark says.
        remark: to be recorded before.
    """

    work: Work
    remark: Drop | ErrorBound | None = None


class Backlog:
    """Work in order; the oldest pings go first, into the map or not. Asks no clock.

    Args:
        policy: what to do when pings wait for too long.

    Attributes:
        pings: that wait, with a pose.
        dropped: pings that waited for too long.
        policy: its name.
        coarse: pings are mapped with `behind.error_bound` at least.
        late: it has fallen behind, and not caught up.
    """

    def __init__(self, policy: Policy) -> None:
        self.pings = self.dropped = 0
        self.coarse = self.late = False
        self.policy: str = policy.policy
        self._policy = policy
        self._max_wait_ns = round(policy.max_wait * 1e9)
        self._waiting: deque[tuple[Work, int]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, work: Work, now_ns: int) -> None:
        """Let work wait for its turn."""
        self._waiting.append((work, now_ns))
        self._count(work, 1)

    def next(self, now_ns: int, error_bound: float, *, patient: bool = False) -> Turn:
        """Take the oldest piece of work.

        Args:
            now_ns: on the clock of `put`.
            error_bound: `mapping.error_bound` of the settings.
            patient: no more pings come, so nothing is dropped.

        Raises:
            IndexError: nothing waits.
        """
        work, since_ns = self._waiting.popleft()
        self._count(work, -1)
        if not isinstance(work, Settled) or isinstance(work.pose, Reject):
            return Turn(work)
        if patient:
            return Turn(work)
        wait_ns = now_ns - since_ns
        if self.pings and (wait_ns > self._max_wait_ns or self._bytes > MAX_BYTES):
            self.dropped += 1
            self.late = True
            return Turn(work, Drop(work.number))
        return Turn(work, self._bound(work.number, wait_ns, error_bound))

    def _bound(self, number: int, wait_ns: int, error_bound: float) -> ErrorBound | None:
        """Become coarser half way to dropping, and fine again once caught up."""
        caught_up = wait_ns < CAUGHT_UP * self._max_wait_ns
        if self.coarse and caught_up:
            self.coarse = self.late = False
            return ErrorBound(number, None)
        self.late = self.late and not caught_up
        coarser = self._policy.policy == "coarser_first" and error_bound < self._policy.error_bound
        if coarser and not self.coarse and wait_ns > COARSE_FROM * self._max_wait_ns:
            self.coarse = self.late = True
            return ErrorBound(number, self._policy.error_bound)
        return None

    def _count(self, work: Work, one: int) -> None:
        if isinstance(work, Settled) and not isinstance(work.pose, Reject):
            self.pings += one
            self._bytes += one * work.ping.image.nbytes
