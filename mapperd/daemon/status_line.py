"""One line that says how it goes: `systemctl status` shows it."""

from collections.abc import Mapping
from typing import Any

__all__ = ["StatusLine"]

MIB = 1 << 20


class StatusLine:
    """Makes the line from the daemon's status; rates are those since the last line."""

    def __init__(self) -> None:
        self._before: tuple[float, int] | None = None

    def of(self, status: Mapping[str, Any], now_s: float) -> str:
        """The line.

        Args:
            status: as `Operations.status` gives it.
            now_s: a clock that only goes forward.
        """
        pings: Mapping[str, Any] = status.get("pings") or {}
        mapped = int(pings.get("mapped", 0))
        parts = [str(status.get("phase", "running"))]
        if self._before is not None and now_s > self._before[0]:
            rate_hz = max(0, mapped - self._before[1]) / (now_s - self._before[0])
            parts.append(f"{rate_hz:.1f} pings/s")
        self._before = (now_s, mapped)
        parts.append(f"{mapped} mapped")
        dropped = sum((pings.get("dropped") or {}).values())
        if dropped:
            parts.append(f"{dropped} dropped")
        if link := (status.get("sonar") or {}).get("state"):
            parts.append(f"sonar {link}")
        memory_bytes = (status.get("map") or {}).get("memory_bytes")
        if memory_bytes is not None:
            parts.append(f"map {memory_bytes / MIB:.0f} MiB")
        return ", ".join(parts)
