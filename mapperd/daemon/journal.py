"""Events as lines of a journal: with a priority where journald reads, without repeats."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from mapperd.events import Event, Severity

__all__ = ["Journal", "goes_to_journal"]

PRIORITIES = {
    Severity.ERROR: 3,
    Severity.WARNING: 4,
    Severity.NOTICE: 5,
    Severity.INFO: 6,
    Severity.DEBUG: 7,
}
"""Of syslog(3), as sd-daemon(3) writes them before a line."""

REPEAT_S = 10.0
"""Minimum time between two lines of the same code and subject; doubles while the event repeats."""

MAX_REPEAT_S = 3600.0

MAX_REMEMBERED = 256


@dataclass(slots=True)
class _Logged:
    """The last line of one code and subject: its time, the pause after it, repeats since."""

    at_s: float
    pause_s: float
    repeats: int = 0


class Writable(Protocol):
    """Takes text."""

    def write(self, text: str, /) -> object:
        """Write it."""

    def flush(self) -> None:
        """Bring it out."""


class Journal:
    """Writes events as lines; repeated events are counted and logged once.

    Args:
        stream: standard error.
        priorities: begin each line with `<n>`.
        clock: seconds, only forward.
        min_severity: events that are less severe are left out.
    """

    def __init__(
        self,
        stream: Writable,
        clock: Callable[[], float],
        *,
        priorities: bool,
        min_severity: Severity = Severity.INFO,
    ) -> None:
        self._stream = stream
        self._clock = clock
        self._priorities = priorities
        self._max_priority = PRIORITIES[min_severity]
        self._logged: dict[tuple[str, str], _Logged] = {}

    def write(self, event: Event) -> None:
        """Write an event, unless the same was written just now."""
        if PRIORITIES[event.severity] > self._max_priority:
            return
        key, now_s = (event.code, event.subject), self._clock()
        logged = self._logged.get(key)
        if logged is not None and now_s - logged.at_s < logged.pause_s:
            logged.repeats += 1
            return
        self._remember(key, logged, now_s)
        again = f" (repeated {logged.repeats} times since)" if logged and logged.repeats else ""
        self._line(event.severity, f"{event.text}{again}")

    def _remember(self, key: tuple[str, str], before: "_Logged | None", now_s: float) -> None:
        goes_on = before is not None and before.repeats > 0
        pause_s = min(2 * before.pause_s, MAX_REPEAT_S) if before and goes_on else REPEAT_S
        self._logged.pop(key, None)
        while len(self._logged) >= MAX_REMEMBERED:
            self._logged.pop(next(iter(self._logged)))
        self._logged[key] = _Logged(now_s, pause_s)

    def _line(self, severity: Severity, text: str) -> None:
        mark = f"<{PRIORITIES[severity]}>" if self._priorities else "mapperd: "
        line = " ".join(text.split("\n"))  # one event is one line, whatever is in it
        try:
            self._stream.write(f"{mark}{line}\n")
            self._stream.flush()
        except (OSError, ValueError):  # nobody reads any more, which is no reason to end
            return


def goes_to_journal(environ: Mapping[str, str], file_number: int) -> bool:
    """Return whether journald reads a stream: `JOURNAL_STREAM` gives device and inode."""
    try:
        facts = os.fstat(file_number)
    except OSError:
        return False
    return environ.get("JOURNAL_STREAM", "") == f"{facts.st_dev}:{facts.st_ino}"
