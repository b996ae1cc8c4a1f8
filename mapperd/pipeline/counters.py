"""Counters of everything that came in, and the latency of pings."""

from array import array
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

__all__ = ["Latency", "PipelineCounters"]

MAX_TIMES = 100_000
"""A daemon runs for months."""


@dataclass(slots=True)
class PipelineCounters:
    """Counts of one replay; pings_total == pings_mapped + sum(pings_dropped.values()).

    Attributes:
        pings_total: pings that came within the chosen time, whatever became of them.
        pings_outside: pings that were read and came outside of it.
        pings_mapped: pings in the map.
        pings_dropped: reason to count.
        first_drop: reason to the sentence that its first case was explained with.
        bytes_total: bytes of sonar stream.
        bytes_rejected: bytes that belong to no message.
        resyncs: times that the start of the next message was lost.
        messages_rejected: reason to count, from the stream parser.
        messages_doubtful: warning to count, of messages that were taken all the same.
        pings_lost: ping numbers that never came, not even with a message that was dropped.
        step_s: seconds that mapped or refused pings took in the step: all, or, of more than
            `MAX_TIMES`, some from all over the dive.
        longest_s: the largest of all.
    """

    pings_total: int = 0
    pings_outside: int = 0
    pings_mapped: int = 0
    pings_dropped: Counter[str] = field(default_factory=Counter)
    first_drop: dict[str, str] = field(default_factory=dict)
    bytes_total: int = 0
    bytes_rejected: int = 0
    resyncs: int = 0
    messages_rejected: Counter[str] = field(default_factory=Counter)
    messages_doubtful: Counter[str] = field(default_factory=Counter)
    pings_lost: int = 0
    step_s: "array[float]" = field(default_factory=lambda: array("d"))
    longest_s: float = 0.0
    _every: int = 1
    _passed: int = 0

    def drop(self, reason: str, detail: str) -> None:
        """Count a ping that will not be in the map."""
        self.pings_dropped[reason] += 1
        self.first_drop.setdefault(reason, detail)

    def took(self, seconds: float) -> None:
        """Note how long a ping took."""
        self.longest_s = max(self.longest_s, seconds)
        self._passed += 1
        if self._passed % self._every:
            return
        self.step_s.append(seconds)
        if len(self.step_s) > MAX_TIMES:
            self.step_s = self.step_s[1::2]
            self._every *= 2

    def ms_per_ping(self) -> dict[str, float]:
        """Median, 95th percentile and largest time of a step in milliseconds; 0 without any."""
        times_ms = 1e3 * np.asarray(self.step_s) if self.step_s else np.zeros(1)
        p50, p95 = np.percentile(times_ms, [50, 95])
        return {"p50": float(p50), "p95": float(p95), "max": 1e3 * self.longest_s}


WINDOW_NS = 60_000_000_000
MAX = 4096


class Latency:
    """Of the pings that were mapped in the last minute."""

    def __init__(self) -> None:
        self._pings: deque[tuple[int, int]] = deque(maxlen=MAX)

    def add(self, complete_ns: int, mapped_ns: int) -> None:
        """Note a ping: when its last byte had come, and when it was in the map."""
        self._pings.append((mapped_ns, mapped_ns - complete_ns))

    def percentiles_ms(self, now_ns: int) -> dict[str, float] | None:
        """`p50`, `p95`, `p99` in milliseconds; None without a ping."""
        while self._pings and now_ns - self._pings[0][0] > WINDOW_NS:
            self._pings.popleft()
        if not self._pings:
            return None
        took_ms = [took_ns / 1e6 for _, took_ns in self._pings]
        p50, p95, p99 = np.percentile(took_ms, [50, 95, 99])
        return {"p50": float(p50), "p95": float(p95), "p99": float(p99)}
