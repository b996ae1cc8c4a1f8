"""The daemon's event log: numbered events, a bounded history, and listeners."""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

__all__ = ["Event", "EventLog", "Severity"]

KEPT = 1000
"""Default size of the history."""


class Severity(StrEnum):
    """How bad an event is; names are those of the journal's priorities 3 to 7."""

    ERROR = "error"
    WARNING = "warning"
    NOTICE = "notice"
    INFO = "info"
    DEBUG = "debug"


@dataclass(frozen=True, slots=True)
class Event:
    """An event.

    Attributes:
        number: counts events from 1.
        t_ns: Unix time.
        severity: severity.
        code: short and stable, for programs: `sonar_link`, `setting_changed`.
        text: one line for people.
        facts: plain values, units in the keys.
    """

    number: int
    t_ns: int
    severity: Severity
    code: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "number": self.number,
            "t_s": self.t_ns / 1e9,
            "severity": str(self.severity),
            "code": self.code,
            "text": self.text,
            "facts": dict(self.facts),
        }


class EventLog:
    """The newest events; every method may be called from any thread.

    Args:
        clock: Unix time in nanoseconds.
        kept: size of the history.
    """

    def __init__(self, clock: Callable[[], int], kept: int = KEPT) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=kept)
        self._number = 0
        self._listeners: list[Callable[[Event], None]] = []
        self._lock = threading.Lock()

    @property
    def last(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._number

    def add(self, severity: Severity, code: str, text: str, **facts: Any) -> Event:  # noqa: ANN401 plain values
        """Add an event and call the listeners in this thread."""
        with self._lock:
            self._number += 1
            event = Event(self._number, self._clock(), severity, code, text, facts)
            self._events.append(event)
            listeners = tuple(self._listeners)
        for listener in listeners:
            listener(event)
        return event

    def since(self, number: int) -> tuple[list[Event], int]:
        """Return the events after a number, oldest first, and how many were already discarded."""
        with self._lock:
            events = [event for event in self._events if event.number > number]
            first = events[0].number if events else self._number + 1
        return events, max(0, first - 1 - max(number, 0))

    def listen(self, listener: Callable[[Event], None]) -> Callable[[], None]:
        """Call a listener with every later event; return a function that removes it.

        Args:
            listener: called in the thread that adds; it must neither block nor raise.
        """
        with self._lock:
            self._listeners.append(listener)

        def end() -> None:
            with self._lock:
                self._listeners.remove(listener)

        return end
