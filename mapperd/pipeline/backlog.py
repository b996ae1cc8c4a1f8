"""Decoded work that waits for the map; drops the oldest pings when mapping is too slow."""

from collections import deque
from typing import TypeGuard

from mapperd.config.daemon import BacklogConfig
from mapperd.errors import Reject
from mapperd.pipeline.decoder import PosedPing, Work

__all__ = ["Backlog"]

MAX_BYTES = 64 * 1024 * 1024
"""Maximum size of the waiting images; above this the oldest pings are dropped."""

CAUGHT_UP = 0.1
"""Fraction of `behind.max_wait` below which the backlog is no longer late."""


class Backlog:
    """A queue of work, oldest first. Reads no clock.

    Args:
        settings: how long a ping may wait.

    Attributes:
        pings: number of waiting pings with a pose.
        dropped: number of pings that waited too long.
        late: pings were dropped and the backlog has not recovered yet.
    """

    def __init__(self, settings: BacklogConfig) -> None:
        self.pings = self.dropped = 0
        self.late = False
        self._max_wait_ns = round(settings.max_wait * 1e9)
        self._waiting: deque[tuple[Work, int]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, work: Work, arrival_ns: int) -> None:
        """Append work.

        Args:
            work: the next piece.
            arrival_ns: of the bytes that completed it: the ping's own, or the odometry's for its
                pose. The time that they waited to be decoded counts.
        """
        self._waiting.append((work, arrival_ns))
        self._count(work, 1)

    def rest(self) -> None:
        """Note that no input waits: an empty backlog is not late."""
        self.late = self.late and bool(self._waiting)

    def next(self, now_ns: int, *, patient: bool = False) -> tuple[Work, bool]:
        """Remove the oldest piece of work; return it and whether it is a ping to drop.

        Args:
            now_ns: on the clock of the arrivals.
            patient: no more pings arrive, so none is dropped.

        Raises:
            IndexError: nothing waits.
        """
        work, arrival_ns = self._waiting.popleft()
        self._count(work, -1)
        if patient or not _is_mappable(work):
            return work, False
        wait_ns = now_ns - arrival_ns
        if self.pings and (wait_ns > self._max_wait_ns or self._bytes > MAX_BYTES):
            self.dropped += 1
            self.late = True
            return work, True
        self.late = self.late and wait_ns >= CAUGHT_UP * self._max_wait_ns
        return work, False

    def _count(self, work: Work, one: int) -> None:
        if _is_mappable(work):
            self.pings += one
            self._bytes += one * work.ping.image.nbytes


def _is_mappable(work: Work) -> TypeGuard[PosedPing]:
    return isinstance(work, PosedPing) and not isinstance(work.pose, Reject)
