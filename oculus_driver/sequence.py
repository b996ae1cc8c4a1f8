"""Ping ids in order: gaps are lost pings, a repeat is a duplicate, a step back a restart."""

from __future__ import annotations

from dataclasses import dataclass

_WRAP = 1 << 32


@dataclass(slots=True)
class PingSequence:
    """Counts what the ids of one sonar's pings say.

    Attributes:
        lost_pings: ids that never came.
        duplicates: ids that came twice in a row.
        restarts: steps back, as after power-up.
    """

    lost_pings: int = 0
    duplicates: int = 0
    restarts: int = 0
    _last: int | None = None

    def accept(self, ping_id: int) -> bool:
        """Take the next id; return False if the ping was delivered already."""
        last, self._last = self._last, ping_id
        if last is None:
            return True
        step = (ping_id - last) % _WRAP
        if step == 0:
            self.duplicates += 1
            return False
        if step < _WRAP // 2:
            self.lost_pings += step - 1
        else:
            self.restarts += 1
        return True

    def restart(self) -> None:
        """Count a restart that something else shows; the next id follows none."""
        self.restarts += 1
        self._last = None
