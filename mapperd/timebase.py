"""A sender's clock carried over to ours: the lower envelope of arrival minus stamp.

Delay only ever adds, so the smallest difference seen lately is the best estimate of the offset;
see E. Olson, "A passive solution to the sensor synchronization problem", IROS 2010.
"""

from collections import deque

__all__ = ["LowerEnvelope"]

WINDOW_NS = 10_000_000_000
"""How long a difference counts: long enough for a prompt record, short enough for drift."""

JUMP_NS = 1_000_000_000
"""A stamp further than this ahead of its arrival is no drift: the clock has jumped."""


class LowerEnvelope:
    """Offset of one sender's clock, learnt from its stamps as they arrive."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, int]] = deque()  # (arrival, offset), offsets rising
        self._last_stamp_ns: int | None = None
        self._suspect: tuple[int, int] | None = None  # (stamp, arrival)

    def to_host_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Host time of a stamp, or None while the clock looks as if it had jumped.

        A late record is only late. One stray stamp is left out; two in a row that agree with
        each other start the fit anew.

        Args:
            stamp_ns: on the sender's clock.
            arrival_ns: when it arrived, on the host's clock.
        """
        if self._jumped(stamp_ns, arrival_ns):
            confirmed = self._suspect is not None and _agree(self._suspect, (stamp_ns, arrival_ns))
            self._suspect = (stamp_ns, arrival_ns)
            if not confirmed:
                return None
            self._recent.clear()
        self._last_stamp_ns, self._suspect = stamp_ns, None
        return stamp_ns + self._smallest_offset(arrival_ns - stamp_ns, arrival_ns)

    def _jumped(self, stamp_ns: int, arrival_ns: int) -> bool:
        if self._last_stamp_ns is None:
            return False
        ahead_ns = stamp_ns + self._recent[0][1] - arrival_ns
        return stamp_ns < self._last_stamp_ns or ahead_ns > JUMP_NS

    def _smallest_offset(self, offset_ns: int, arrival_ns: int) -> int:
        """Sliding minimum in constant time: larger and older entries can never win again."""
        while self._recent and self._recent[-1][1] >= offset_ns:
            self._recent.pop()
        self._recent.append((arrival_ns, offset_ns))
        while self._recent[0][0] < arrival_ns - WINDOW_NS:
            self._recent.popleft()
        return self._recent[0][1]


def _agree(before: tuple[int, int], now: tuple[int, int]) -> bool:
    """Whether both clocks say the same about the time between two records."""
    stamps, arrivals = now[0] - before[0], now[1] - before[1]
    return stamps >= 0 and abs(stamps - arrivals) <= JUMP_NS
