"""What happened to everything that came in: no byte, record or ping goes uncounted."""

from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

__all__ = ["ReplayCounters"]


@dataclass(slots=True)
class ReplayCounters:
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
        step_s: seconds that each mapped or refused ping took in the step.
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

    def drop(self, reason: str, detail: str) -> None:
        """Count a ping that will not be in the map."""
        self.pings_dropped[reason] += 1
        self.first_drop.setdefault(reason, detail)

    def ms_per_ping(self) -> dict[str, float]:
        """Median, 95th percentile and largest time of a step in milliseconds; 0 without any."""
        times_ms = 1e3 * np.asarray(self.step_s) if self.step_s else np.zeros(1)
        p50, p95 = np.percentile(times_ms, [50, 95])
        return {"p50": float(p50), "p95": float(p95), "max": float(times_ms.max())}
