"""Saves the vehicle's estimated pose now and then, to go on there after a restart."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from mapperd.config.tree import Amcl
from mapperd.errors import ExportError
from mapperd.events import EventLog, Severity
from mapperd.localization.saved_pose import SavePace, save_pose
from mapperd.localization.status import LocalizationFacts

__all__ = ["PoseKeeper"]

LOOK_S = 0.2
"""So often facts are told."""


class PoseKeeper:
    """Writes the newest estimate at `amcl.save_pose_rate`, and once at the end.

    An ambiguous one is not written: whoever began there again would hold it for sure.

    Args:
        path: of the file.
        facts: the newest.
        amcl: the settings in force.
        clock: Unix time, nanoseconds.
        events: is told when saving begins to fail.
    """

    def __init__(
        self,
        path: Path,
        facts: Callable[[], LocalizationFacts | None],
        amcl: Callable[[], Amcl],
        clock: Callable[[], int],
        events: EventLog | None = None,
    ) -> None:
        self._path = path
        self._facts = facts
        self._amcl = amcl
        self._clock = clock
        self._events = events
        self._written: int | None = None
        self._stuck = False

    async def run(self) -> None:
        """Save until cancelled."""
        pace = SavePace(self._amcl().save_pose_rate)
        while True:
            rate_hz = self._amcl().save_pose_rate
            await asyncio.sleep(min(LOOK_S, 1 / rate_hz) if rate_hz > 0 else LOOK_S)
            pace = SavePace(rate_hz, pace.last_s)
            if pace.is_due(time.monotonic()):
                await asyncio.to_thread(self.save)
                pace = pace.saved(time.monotonic())

    def save(self) -> None:
        """Write the newest estimate, if there is a new one to go on from; not in an event loop."""
        facts, amcl = self._facts(), self._amcl()
        if facts is None or facts.belief is None or facts.belief.ambiguous:
            return
        if not amcl.save_pose_rate > 0 or facts.stamp_ns == self._written:
            return
        try:
            save_pose(self._path, facts.belief.best, amcl.global_frame_id, self._clock())
        except ExportError as error:
            self._say_stuck(str(error))
        else:
            self._written, self._stuck = facts.stamp_ns, False

    def _say_stuck(self, problem: str) -> None:
        if self._events is not None and not self._stuck:
            text = f"the estimated pose is not saved: {problem}"
            self._events.add(Severity.WARNING, "pose_not_saved", text)
        self._stuck = True
