"""Everything that comes in goes to disk as it came, before it is understood."""

import os
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from mapperd.config.paths import recordings_folder
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.odometry.bridge import encoding_of
from mapperd.pipeline.watchdog import Worker
from mapperd.session_log import DECISIONS, LINK, SESSION
from mapperd.store.position import RecordingOffset
from oculus_driver.errors import RecordingError
from oculus_driver.recording import OCULUS, BackgroundLog, Chunk, LogPolicy, SonarLog

__all__ = ["Recorder"]

MIB = 1 << 20


class Recorder:
    """Records all links, `async with`, unless the settings say not to.

    Args:
        config: `recording` and the sources of the odometry. Arrivals are Unix nanoseconds.
        session: id that each file holds.
        clock: of the arrivals, nanoseconds.

    Raises:
        ConfigError: the folder cannot be made, or the limits contradict each other.
    """

    def __init__(
        self, config: Config, session: str, clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._log: BackgroundLog | None = None
        settings = config.recording
        if not settings.enabled:
            return
        try:
            policy = LogPolicy(
                max_file_bytes=settings.max_file * MIB,
                budget_bytes=settings.budget * MIB or None,
                free_floor_bytes=settings.free_floor * MIB,
            )
            sources = {source.name: encoding_of(source) for source in config.odometry.sources}
            self._files = SonarLog(
                recordings_folder(config, os.environ),
                policy,
                prefix="dive",
                metadata={SESSION: session},
                others={LINK: DECISIONS, **sources},
                hold=True,
            )
        except RecordingError as error:
            raise ConfigError(f"recording: {error}", "$.recording") from error
        self._log = BackgroundLog(self._files, clock=clock)

    async def __aenter__(self) -> Self:
        """Begin to record."""
        if self._log is not None:
            await self._log.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write what waits."""
        if self._log is not None:
            await self._log.__aexit__(kind, error, trace)

    @property
    def newest(self) -> int:
        """Number of the newest piece; 0 before the first, or where nothing is recorded."""
        return 0 if self._log is None else self._log.offered

    def place_of(self, number: int) -> RecordingOffset | None:
        """Where the recording goes on behind a piece; None while that is not written."""
        if self._log is None or number == 0:
            return RecordingOffset()
        place = self._log.position_of(number)
        return None if place is None else RecordingOffset(place.file, place.messages)

    def wait_for(self, number: int, timeout_s: float) -> bool:
        """Wait until the operating system has a piece; False if that takes longer."""
        return self._log is None or self._log.wait_for(number, timeout_s)

    def record(self, chunk: Chunk, *, gap: bool) -> int:
        """Record a chunk at once, without waiting for the disk; not two threads at a time.

        Returns:
            its number.

        Args:
            chunk: of the sonar, a source of odometry, or a decision.
            gap: bytes of its link are missing before it.
        """
        if self._log is None or chunk.arrival_ns is None:
            return 0
        if chunk.encoding == OCULUS:
            self._log.write(chunk.data, chunk.arrival_ns, gap_before=gap)
        else:
            self._log.write_other(chunk.link, chunk.data, chunk.arrival_ns, gap_before=gap)
        return self._log.offered

    def worker(self) -> Worker:
        """For a watchdog: who waits for a disk with room is not stuck."""
        if self._log is None:
            return Worker("recording", 0, 0)
        counters = self._files.counters
        held = self._files.reason or "paused" if self._files.state == "paused" else ""
        done = counters.bytes_written + counters.bytes_dropped + counters.syncs
        return Worker("recording", self._log.waiting_bytes, done, held)

    def status(self) -> dict[str, object] | None:
        """For a person: what it does and what was lost; None where nothing is recorded."""
        if self._log is None:
            return None
        counters = self._files.counters
        return {
            "state": self._files.state,
            "reason": self._files.reason,
            "bytes_waiting": self._log.waiting_bytes,
            "bytes_written": counters.bytes_written,
            "bytes_dropped": counters.bytes_dropped + self._log.bytes_dropped,
            "drops": dict(counters.drops),
            "files": counters.files_opened,
            "files_deleted": counters.files_deleted,
        }
