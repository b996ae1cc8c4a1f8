"""The time of a MAVLink system: milliseconds since it booted, made to run on."""

from mapperd.odometry.records import Clock

__all__ = ["BootClock", "stamp_of_us"]

WRAP_MS = 1 << 32
NEAR_WRAP_MS = 3_600_000
"""A counter this near its end, and then this near its beginning, has wrapped: after 49.7 days."""

REBOOT_MS = 1000
"""Datagrams overtake each other by less than this."""

_UNIX_FROM_US = 10**15
"""A number of microseconds that is 2001 or later in Unix time; nothing runs for 30 years."""


class BootClock:
    """Follows the 32-bit counter of one system.

    Attributes:
        reboots: times that it began anew.
    """

    def __init__(self) -> None:
        self.reboots = 0
        self._wraps = 0
        self._last_ms: int | None = None

    def stamp_ns(self, boot_ms: int) -> int:
        """Nanoseconds since boot."""
        last_ms = boot_ms if self._last_ms is None else self._last_ms
        if last_ms >= WRAP_MS - NEAR_WRAP_MS and boot_ms < NEAR_WRAP_MS:
            self._wraps += 1
        elif boot_ms >= WRAP_MS - NEAR_WRAP_MS and last_ms < NEAR_WRAP_MS and self._wraps:
            # Overtaken by the wrap: of before, and not to be followed.
            return ((self._wraps - 1) * WRAP_MS + boot_ms) * 1_000_000
        elif boot_ms < last_ms - REBOOT_MS:
            self.reboots += 1
            self._wraps = 0
        self._last_ms = boot_ms
        return (self._wraps * WRAP_MS + boot_ms) * 1_000_000


def stamp_of_us(time_us: int) -> tuple[int, Clock]:
    """Stamp and clock of a number of microseconds that is since boot or of Unix, by its size."""
    return time_us * 1000, "unix" if time_us >= _UNIX_FROM_US else "boot"
