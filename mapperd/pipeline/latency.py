"""How long pings take from their last byte into the map."""

from collections import deque

import numpy as np

__all__ = ["Latency"]

WINDOW_NS = 60_000_000_000
MOST = 4096


class Latency:
    """Of the pings that were mapped in the last minute."""

    def __init__(self) -> None:
        self._pings: deque[tuple[int, int]] = deque(maxlen=MOST)

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
