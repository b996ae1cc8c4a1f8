"""Records all input unchanged, before it is decoded."""

import os
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from mapperd.config.paths import recordings_folder
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError
from mapperd.odometry.bridge import encoding_of
from mapperd.pipeline.watchdog import Worker
from mapperd.session_log import DECISIONS, LINK, SESSION
from mapperd.store.position import RecordingOffset
from oculus_driver.errors import RecordingError
from oculus_driver.recording import OCULUS, BackgroundLog, Chunk, LogPolicy, SonarLog
from oculus_driver.stream import MessageBounds

__all__ = ["PREFIX", "Recorder"]

PREFIX = "dive"
"""Names of the files begin with it."""

MIB = 1 << 20


class Recorder:
    """Records all links within an `async with` block, if `recording.enabled` is set.

    Args:
        config: `recording` and the odometry sources. Arrivals are Unix nanoseconds.
        session: id for each file.
        clock: of the arrivals, nanoseconds.

    Raises:
        ConfigError: the limits contradict each other.
        ExportError: the folder cannot be created, or not be written to.
    """

    def __init__(
        self, config: Config, session: str, clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._log: BackgroundLog | None = None
        settings = config.recording
        if not settings.enabled:
            return
        try:
            folder = recordings_folder(config, os.environ)
            policy = LogPolicy(
                max_file_bytes=settings.max_file * MIB,
                budget_bytes=settings.budget * MIB or None,
                free_floor_bytes=settings.free_floor * MIB,
            )
            sources = {source.name: encoding_of(source) for source in config.odometry.sources}
            self._files = SonarLog(
                folder,
                policy,
                prefix=PREFIX,
                metadata={SESSION: session},
                others={LINK: DECISIONS, **sources},
                hold=True,
            )
        except RecordingError as error:
            if isinstance(error.__cause__, OSError):
                raise ExportError(f"recording.folder: {error}") from error
            raise ConfigError(f"recording: {error}", "$.recording") from error
        if not os.access(folder, os.W_OK | os.X_OK):
            raise ExportError(f"recording.folder: {folder}: no files can be created in it")
        self._log = BackgroundLog(self._files, clock=clock)

    async def __aenter__(self) -> Self:
        """Start recording."""
        if self._log is not None:
            await self._log.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write all waiting data."""
        if self._log is not None:
            await self._log.__aexit__(kind, error, trace)

    @property
    def missing(self) -> str:
        """Why the recording lacks a part of the session; empty if it does not."""
        if self._log is None:
            return "it is not recorded"
        lost = self._files.counters.bytes_dropped + self._log.bytes_dropped
        return f"{lost} bytes are not recorded" if lost else ""

    @property
    def lost_at_once(self) -> str:
        """What of the session is not recorded if the process ends now; empty without a gap."""
        if self._log is None or self.missing:
            return self.missing
        if self._files.state == "paused":
            waiting, reason = self._log.waiting_bytes, self._files.reason
            return f"the recording is paused ({reason}), and {waiting} bytes of it are in memory"
        return "" if self._files.counters.files_opened else "no file was written yet"

    def shortage(self) -> str | None:
        """Return why nothing can be recorded at the moment; None if it can, or need not be."""
        if self._log is None:
            return None
        try:
            shortage = self._files.shortage
        except OSError as error:
            shortage = error.strerror
        if shortage is None:
            return None
        floor_mib = self._files.policy.free_floor_bytes // MIB
        return f"{self._files.folder}: {shortage}; recording.free_floor is {floor_mib} MiB"

    @property
    def newest(self) -> int:
        """Number of the newest piece; 0 before the first, and without a recording."""
        return 0 if self._log is None else self._log.offered

    @property
    def end(self) -> RecordingOffset | None:
        """Position after the newest piece; None while that is not written."""
        return self.place_of(self.newest)

    def place_of(self, number: int) -> RecordingOffset | None:
        """Return the position after a piece; None while the piece is not written."""
        if self._log is None or number == 0:
            return RecordingOffset()
        place = self._log.position_of(number)
        return None if place is None else RecordingOffset(place.file, place.messages)

    def wait_for(self, number: int, timeout_s: float) -> bool:
        """Wait until a piece is on the disk, for power cuts; return False on a timeout."""
        return self._log is None or self._log.wait_for(number, timeout_s)

    def record(self, chunk: Chunk, *, gap: bool, bounds: MessageBounds | None = None) -> int:
        """Queue a chunk for the disk; not thread-safe. Return the number of the piece.

        Args:
            chunk: of the sonar, an odometry source, or a decision.
            gap: bytes of its link are missing in front of it.
            bounds: message boundaries in a chunk of the sonar; None: it is whole messages.
        """
        if self._log is None or chunk.arrival_ns is None:
            return 0
        if chunk.encoding == OCULUS:
            bounds = bounds or MessageBounds(0, len(chunk.data))
            self._log.write(chunk.data, chunk.arrival_ns, bounds, gap_before=gap)
        else:
            self._log.write_other(chunk.link, chunk.data, chunk.arrival_ns, gap_before=gap)
        return self._log.offered

    def worker(self) -> Worker:
        """Return the progress for the watchdog; a recorder that waits for disk space is held."""
        if self._log is None:
            return Worker("recording", 0, 0)
        counters = self._files.counters
        held = self._files.reason or "paused" if self._files.state == "paused" else ""
        done = counters.bytes_written + counters.bytes_dropped + counters.syncs
        return Worker("recording", self._log.waiting_bytes, done, held)

    def status(self) -> dict[str, object] | None:
        """Return state and losses for a person; None without a recording."""
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
