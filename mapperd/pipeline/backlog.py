"""What waits for the map, and what happens when pings come faster than they can be mapped."""

from collections import deque
from dataclasses import dataclass
from typing import TypeGuard

from mapperd.config.daemon import BacklogConfig
from mapperd.errors import Reject
from mapperd.pipeline.decoder import PosedPing, Work

__all__ = ["Backlog", "Turn"]

MAX_BYTES = 64 * 1024 * 1024
"""Images that may wait for their turn; beyond, the oldest are dropped."""

CAUGHT_UP = 0.1
"""Share of `behind.max_wait` below which all is well again."""


@dataclass(frozen=True, slots=True)
class Turn:
    """What is to be done next.

    Attributes:
        work: the oldest piece.
        dropped: it is a ping that waited for too long and must not be mapped.
    """

    work: Work
    dropped: bool = False


class Backlog:
    """Work in order; the oldest pings go first, into the map or not. Asks no clock.

    Args:
        settings: how long a ping may wait.

    Attributes:
        pings: that wait, with a pose.
        dropped: pings that waited for too long.
        late: it has fallen behind, and not caught up.
    """

    def __init__(self, settings: BacklogConfig) -> None:
        self.pings = self.dropped = 0
        self.late = False
        self._max_wait_ns = round(settings.max_wait * 1e9)
        self._waiting: deque[tuple[Work, int]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, work: Work, now_ns: int) -> None:
        """Let work wait for its turn."""
        self._waiting.append((work, now_ns))
        self._count(work, 1)

    def next(self, now_ns: int, *, patient: bool = False) -> Turn:
        """Take the oldest piece of work.

        Args:
            now_ns: on the clock of `put`.
            patient: no more pings come, so nothing is dropped.

        Raises:
            IndexError: nothing waits.
        """
        work, since_ns = self._waiting.popleft()
        self._count(work, -1)
        if patient or not _is_mappable(work):
            return Turn(work)
        wait_ns = now_ns - since_ns
        if self.pings and (wait_ns > self._max_wait_ns or self._bytes > MAX_BYTES):
            self.dropped += 1
            self.late = True
            return Turn(work, dropped=True)
        self.late = self.late and wait_ns >= CAUGHT_UP * self._max_wait_ns
        return Turn(work)

    def _count(self, work: Work, one: int) -> None:
        if _is_mappable(work):
            self.pings += one
            self._bytes += one * work.ping.image.nbytes


def _is_mappable(work: Work) -> TypeGuard[PosedPing]:
    return isinstance(work, PosedPing) and not isinstance(work.pose, Reject)
