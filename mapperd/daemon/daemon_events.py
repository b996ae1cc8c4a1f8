"""Notices what changes in a running session, and says it as events."""

import asyncio
from typing import NoReturn

from mapperd.daemon.localization_events import LocalizationWatch
from mapperd.daemon.session import Live
from mapperd.events import EventLog, Severity
from mapperd.pipeline.worker import Facts

__all__ = ["Watch"]

LOOK_S = 1.0
TELL_S = 10.0
"""Between looks at whether odometry still comes."""


class Watch:
    """Looks at one session.

    Args:
        events: is told.
        live: the session.
    """

    def __init__(self, events: EventLog, live: Live) -> None:
        self._events = events
        self._live = live
        self._late = False
        self._dropped = 0
        self._recording: object = None
        self._localization = LocalizationWatch(events)

    def told(self, facts: Facts) -> None:
        """Look at new facts; in the mapping thread."""
        if facts.localization is not None:
            self._localization.told(facts.localization)
        behind = facts.behind
        if behind["late"] == self._late:
            return
        self._late = behind["late"]
        if self._late:
            text = "pings come faster than they can be mapped"
            self._events.add(Severity.WARNING, "behind", text)
            return
        dropped, self._dropped = behind["dropped"] - self._dropped, behind["dropped"]
        text = f"mapping has caught up; {dropped} pings were dropped"
        self._events.add(Severity.NOTICE, "caught_up", text, pings_dropped=dropped)

    async def look(self) -> NoReturn:
        """Look every now and then at what tells nobody, until cancelled."""
        heard, silent_s = self._heard(), 0.0
        while True:
            await asyncio.sleep(LOOK_S)
            self._look_at_recording()
            now_heard = self._heard()
            silent_s = 0.0 if now_heard != heard else silent_s + LOOK_S
            heard = now_heard
            if silent_s == TELL_S and self._live.links:
                text = f"no odometry for {TELL_S:g} s; see `mapperd doctor`"
                self._events.add(Severity.WARNING, "no_odometry", text)

    def _heard(self) -> int:
        return sum(link.status.bytes_received for link in self._live.links)

    def _look_at_recording(self) -> None:
        status = self._live.recorder.status()
        if status is None or status["state"] == self._recording:
            return
        first, self._recording = self._recording is None, status["state"]
        if first and status["state"] == "logging":
            return
        bad = status["state"] == "paused"
        why = f": {status['reason']}" if status["reason"] else ""
        self._events.add(
            Severity.ERROR if bad else Severity.NOTICE,
            "recording",
            f"recording: {status['state']}{why}",
            state=status["state"],
        )
