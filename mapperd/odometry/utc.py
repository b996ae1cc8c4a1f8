"""The time of day becomes a time: the date is the sender's own, or the nearest to the host's."""

import re
from datetime import UTC, datetime

from mapperd.odometry.records import Clock

__all__ = ["UtcDay"]

FIRST_YEAR, LAST_YEAR = 1980, 2199  # of satellite navigation, and of 64-bit nanoseconds
DAY_NS = 86_400 * 10**9
UNIX_FROM_NS = 10**18
"""A host stamp of 2001 or later is Unix time; a smaller one counts from some other moment."""

_TIME = re.compile(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d|60)(?:\.(\d{0,9})\d*)?")


class UtcDay:
    """Remembers the last date that the sender told, and the last stamp made from it."""

    def __init__(self) -> None:
        self._midnight_ns: int | None = None
        self._last_ns: int | None = None

    def learn(self, day: str, month: str, year: str) -> None:
        """Take a date in digits.

        Raises:
            ValueError: there is no such date.
        """
        if not FIRST_YEAR <= int(year) <= LAST_YEAR:
            raise ValueError(f"the year {year[:20]} is not ours")
        midnight = datetime(int(year), int(month), int(day), tzinfo=UTC)
        midnight_ns = round(midnight.timestamp()) * 10**9
        if midnight_ns != self._midnight_ns:
            self._midnight_ns, self._last_ns = midnight_ns, None

    def stamp(self, text: str, arrival_ns: int | None) -> tuple[int, Clock]:
        """Stamp and clock of a time of day; (0, "arrival") where it cannot be told.

        Args:
            text: hhmmss or hhmmss.ss, or nothing.
            arrival_ns: of the sentence, host clock.

        Raises:
            ValueError: the text is no time of day.
        """
        if not text:
            return 0, "arrival"
        match = _TIME.fullmatch(text)
        if match is None:
            raise ValueError(f"{text[:20]!r} is no time of day")
        seconds = 3600 * int(match[1]) + 60 * int(match[2]) + int(match[3])
        of_day_ns = seconds * 10**9 + int((match[4] or "").ljust(9, "0"))
        if self._midnight_ns is not None:
            stamp_ns = self._midnight_ns + of_day_ns
            # The date is told more rarely than the time: midnight may have passed since.
            self._last_ns = _nearest(stamp_ns, self._last_ns or stamp_ns)
            return self._last_ns, "unix"
        if arrival_ns is not None and arrival_ns >= UNIX_FROM_NS:
            return _nearest(of_day_ns, arrival_ns), "unix"
        return 0, "arrival"


def _nearest(stamp_ns: int, near_ns: int) -> int:
    """The stamp, moved by whole days to where it is nearest to the other one."""
    return stamp_ns + round((near_ns - stamp_ns) / DAY_NS) * DAY_NS
