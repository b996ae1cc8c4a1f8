"""Counters of everything received, and the latency of pings."""

from array import array
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from mapperd.errors import Reject

__all__ = ["Latency", "PipelineCounters"]

MAX_TIMES = 100_000
"""Maximum number of kept durations: the daemon may run for months."""


@dataclass(slots=True)
class PipelineCounters:
    """Counters of a session; pings_total == pings_mapped + sum(pings_dropped.values()).

    Attributes:
        pings_total: pings that arrived within the chosen time.
        pings_outside: pings that arrived outside of it.
        pings_mapped: pings in the map.
        pings_dropped: dropped pings by reason.
        first_drop: explanation of the first case of each reason.
        bytes_total: bytes of the sonar's stream.
        bytes_rejected: bytes outside messages.
        resyncs: how often synchronisation with the stream was lost.
        messages_rejected: rejected messages by reason, from the stream parser.
        messages_doubtful: accepted messages with a warning, by warning.
        pings_lost: missing ping numbers, not counting those of rejected messages.
        step_s: seconds in the step of pings with a pose: of all, or of a sample from the whole
            dive if there are more than `MAX_TIMES`.
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

    def drop(self, reject: Reject) -> None:
        """Count a ping that will not be in the map."""
        self.pings_dropped[reject.reason] += 1
        self.first_drop.setdefault(reject.reason, reject.detail)

    def add_time(self, seconds: float) -> None:
        """Add the duration of one step."""
        self.longest_s = max(self.longest_s, seconds)
        self._passed += 1
        if self._passed % self._every:
            return
        self.step_s.append(seconds)
        if len(self.step_s) > MAX_TIMES:
            self.step_s = self.step_s[1::2]
            self._every *= 2

    def ms_per_ping(self) -> dict[str, float]:
        """Return median, 95th percentile and maximum duration of a step, ms; 0 without pings."""
        times_ms = 1e3 * np.asarray(self.step_s) if self.step_s else np.zeros(1)
        p50, p95 = np.percentile(times_ms, [50, 95])
        return {"p50": float(p50), "p95": float(p95), "max": 1e3 * self.longest_s}


WINDOW_NS = 60_000_000_000
MAX = 4096


class Latency:
    """Latency of the pings mapped within the last minute."""

    def __init__(self) -> None:
        self._pings: deque[tuple[int, int]] = deque(maxlen=MAX)

    def add(self, complete_ns: int, mapped_ns: int) -> None:
        """Add a ping: arrival of its last byte, and end of its step, ns."""
        self._pings.append((mapped_ns, mapped_ns - complete_ns))

    def percentiles_ms(self, now_ns: int) -> dict[str, float] | None:
        """Return `p50`, `p95`, `p99` in milliseconds; None without pings."""
        while self._pings and now_ns - self._pings[0][0] > WINDOW_NS:
            self._pings.popleft()
        if not self._pings:
            return None
        latency_ms = [latency_ns / 1e6 for _, latency_ns in self._pings]
        p50, p95, p99 = np.percentile(latency_ms, [50, 95, 99])
        return {"p50": float(p50), "p95": float(p95), "p99": float(p99)}
