"""The daemon's event log: numbered events, a bounded history, and listeners.

An event that keeps repeating is one entry of the history, with a count. If the history is full, the
oldest event of the most frequent code makes room, so no code displaces the others.
"""

import threading
from bisect import bisect_right, insort
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

__all__ = ["Event", "EventLog", "Severity"]

KEPT = 1000
"""Default size of the history."""

SEPARATE = 5
"""Occurrences of an event that are entries of their own; later ones are counted in the last."""

REPEAT_NS = 600_000_000_000
"""An event that occurs again later than this is not a repetition."""

DISCARDED = 10_000
"""Number of discarded events whose numbers are known."""


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
        number: counts events from 1; a repeated event has the number of its newest occurrence.
        t_ns: Unix time of the newest occurrence.
        severity: severity.
        code: short and stable, for programs: `sonar_link`, `setting_changed`.
        text: one line for people.
        facts: plain values, units in the keys.
        count: number of occurrences.
        first_ns: Unix time of the first occurrence; None: the same as `t_ns`.
    """

    number: int
    t_ns: int
    severity: Severity
    code: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)
    count: int = 1
    first_ns: int | None = None

    @property
    def subject(self) -> str:
        """What a repetition has in common: of a link its name and state, as texts hold numbers."""
        if "state" not in self.facts:
            return self.text
        link = self.facts.get("link", self.facts.get("address"))
        return f"{link} {self.facts['state']}"

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "number": self.number,
            "t_s": self.t_ns / 1e9,
            "severity": str(self.severity),
            "code": self.code,
            "text": self.text,
            "facts": dict(self.facts),
            "count": self.count,
            "first_s": (self.t_ns if self.first_ns is None else self.first_ns) / 1e9,
        }


_Key = tuple[Severity, str, str]


def _key(event: Event) -> _Key:
    return event.severity, event.code, event.subject


class EventLog:
    """The newest events; every method may be called from any thread.

    Args:
        clock: Unix time in nanoseconds.
        kept: size of the history.
    """

    def __init__(self, clock: Callable[[], int], kept: int = KEPT) -> None:
        self._clock = clock
        self._kept = kept
        self._events: dict[int, Event] = {}  # by number, oldest first
        self._runs: dict[_Key, tuple[int, int]] = {}  # entries of one content, number of the last
        self._codes: Counter[str] = Counter()
        self._discarded: list[int] = []  # sorted
        self._number = 0
        self._listeners: list[Callable[[Event], None]] = []
        self._lock = threading.Lock()

    @property
    def last(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._number

    def add(self, severity: Severity, code: str, text: str, **facts: Any) -> Event:  # noqa: ANN401 plain values
        """Add an event and call the listeners in this thread.

        An event that has occurred several times lately replaces its last occurrence.
        """
        with self._lock:
            self._number += 1
            event = Event(self._number, self._clock(), severity, code, text, facts)
            event = self._counted(event)
            self._insert(event)
            listeners = tuple(self._listeners)
        for listener in listeners:
            listener(event)
        return event

    def since(self, number: int) -> tuple[list[Event], int]:
        """Return events after a number, oldest first, and how many before them were discarded.

        The list ends where later events were discarded: call again with its last number.
        """
        with self._lock:
            events = [event for event in self._events.values() if event.number > number]
            begin = bisect_right(self._discarded, number)
            if not events:
                return [], len(self._discarded) - begin
            end = bisect_right(self._discarded, events[0].number)
            gap = self._discarded[end] if end < len(self._discarded) else self._number + 1
        return [event for event in events if event.number < gap], end - begin

    def _counted(self, event: Event) -> Event:
        """Return a new event, with the count of the entry that it replaces, which is removed."""
        key = _key(event)
        entries, number = self._runs.get(key, (0, 0))
        before = self._events.get(number)
        if before is None or event.t_ns - before.t_ns > REPEAT_NS:
            self._runs[key] = 1, event.number
            return event
        self._runs[key] = min(entries + 1, SEPARATE), event.number
        if entries < SEPARATE:
            return event
        self._remove(before)
        first_ns = before.t_ns if before.first_ns is None else before.first_ns
        return replace(event, count=before.count + 1, first_ns=first_ns)

    def _insert(self, event: Event) -> None:
        if len(self._events) >= self._kept:
            most = max(self._codes.values())
            oldest = next(one for one in self._events.values() if self._codes[one.code] == most)
            self._remove(oldest)
            insort(self._discarded, oldest.number)
            del self._discarded[:-DISCARDED]
        self._events[event.number] = event
        self._codes[event.code] += 1

    def _remove(self, event: Event) -> None:
        del self._events[event.number]
        if self._runs.get(_key(event), (0, 0))[1] == event.number:
            del self._runs[_key(event)]
        self._codes[event.code] -= 1
        if not self._codes[event.code]:
            del self._codes[event.code]

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
