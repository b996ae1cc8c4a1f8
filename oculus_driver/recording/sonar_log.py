"""Records one sonar and other links indefinitely, within the limits of a disk."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from oculus_driver.errors import RecordingError
from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS
from oculus_driver.recording.log_files import MIB, LogFolder, LogPolicy, free_bytes_of, make_room
from oculus_driver.recording.writer import RecordingWriter

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from types import TracebackType

    from oculus_driver.stream import MessageBounds

_SONAR: Final = "sonar"
_STATUS: Final = "status"

_MARGIN: Final = MIB
"""Growth of a file beyond the data: record heads and index, bytes."""

_CHECK_INTERVAL_NS: Final = 1_000_000_000

MAX_CLOCK_ERROR_NS: Final = 500_000_000
"""A larger difference to the host's clock starts a new file."""

CLOCK_CHANGE: Final = "clock_change_ns"
"""Metadata key: by how much the host's clock was set since the previous file."""


@dataclass(slots=True)
class LogCounters:
    """Counters of a log.

    Attributes:
        bytes_written, bytes_dropped: of the data given to it.
        drops: dropped pieces by reason: budget, free_space, disk (error, see `SonarLog.reason`),
            resuming (the rest of a message whose beginning was dropped).
        files_opened: created files.
        rotations: closed files by reason: size, time, clock (the host's clock was set), failure.
        files_deleted, bytes_deleted: old files deleted for room.
        deletes_failed: old files that could not be deleted.
        syncs: how often data were flushed to the disk.
    """

    bytes_written: int = 0
    bytes_dropped: int = 0
    drops: Counter[str] = field(default_factory=Counter)
    files_opened: int = 0
    rotations: Counter[str] = field(default_factory=Counter)
    files_deleted: int = 0
    bytes_deleted: int = 0
    deletes_failed: int = 0
    syncs: int = 0


class LogPosition(NamedTuple):
    """Position of a log.

    Attributes:
        file: number of the newest file; 0 before the first.
        messages: in that file.
    """

    file: int
    messages: int


class _LogPiece(NamedTuple):
    link: str
    data: bytes
    arrival_ns: int
    gap_before: bool


class _Offset:
    """From the clock of the arrivals to Unix time, as the host's clock is set.

    Attributes:
        ns: that of the present file.
    """

    def __init__(self, source: int | Callable[[], int]) -> None:
        self.ns: int = source if isinstance(source, int) else source()
        self._source = source
        self._files = 0
        self._changed = False
        self._checked_ns: int | None = None

    def has_changed(self, now_ns: int) -> bool:
        """Return whether the clock was set since the file began; looks once per second."""
        if isinstance(self._source, int):
            return False
        last_ns = self._checked_ns
        if last_ns is None or not 0 <= now_ns - last_ns < _CHECK_INTERVAL_NS:
            self._checked_ns = now_ns
            self._changed = abs(self._source() - self.ns) > MAX_CLOCK_ERROR_NS
        return self._changed

    def follow(self) -> int:
        """Begin a file: use the present offset; return by how much the clock was set."""
        before, self._changed = self.ns, False
        if not isinstance(self._source, int):
            self.ns = self._source()
        self._files += 1
        change_ns = self.ns - before
        return change_ns if self._files > 1 and abs(change_ns) > MAX_CLOCK_ERROR_NS else 0


class SonarLog:
    """A series of MCAP files with one sonar's received bytes. Blocking, not thread-safe.

    Each file starts with a message and, without failures, ends with one, so that no ping is split
    between files. Disk errors are never raised: they are counted and reported in `state` and
    `reason`, and recording continues when there is room again. Written data survive a crash of the
    program at any time.

    Args:
        folder: for the files; created if needed.
        policy: the limits.
        prefix: of the file names.
        monotonic_to_unix_ns: added to every stamp; 0 if stamps are nanoseconds since 1970. A
            function is called once per second: if the host's clock was set by more than half a
            second, a new file starts, and its metadata have the change (`clock_change_ns`).
        metadata: free text for each file.
        others: encodings of links recorded beside the sonar, such as odometry, by name.
        free_bytes: returns the free space of the folder's disk.
        hold: keep a piece that cannot be written now instead of dropping it: `holding` is True, and
            nothing else may be written until `retry` has written it.

    Raises:
        RecordingError: the folder cannot be created or read.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        policy: LogPolicy | None = None,
        *,
        prefix: str = "sonar",
        monotonic_to_unix_ns: int | Callable[[], int] = 0,
        metadata: Mapping[str, str] | None = None,
        others: Mapping[str, str] | None = None,
        free_bytes: Callable[[Path], int] = free_bytes_of,
        hold: bool = False,
    ) -> None:
        self.policy = policy or LogPolicy()
        self.counters = LogCounters()
        self.reason: str | None = None
        self._folder = LogFolder(folder, prefix)
        self._offset = _Offset(monotonic_to_unix_ns)
        self._metadata = dict(metadata or {})
        self._links = {_SONAR: OCULUS, _STATUS: OCULUS_STATUS, **(others or {})}
        self._numbers: dict[str, int] = {}
        self._free_bytes = free_bytes
        self._free: int | None = None
        self._free_checked_ns = 0
        self._pending = 0  # received bytes of the incomplete message
        self._writer: RecordingWriter | None = None
        self._messages = 0
        self._began_ns = 0
        self._synced_ns = 0
        self._retry_at_ns: int | None = None
        self._paused_for = ""
        self._unsynced: list[Path] = []  # closed files whose data may not be on the disk
        self._torn = False  # a part of the current message was dropped
        self._gap = False  # so bytes are missing before the next ones
        self._hold = hold
        self._held: _LogPiece | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def state(self) -> str:
        """One of waiting (for the first bytes), logging, paused (see `reason`)."""
        if self._retry_at_ns is not None:
            return "paused"
        return "waiting" if self._writer is None else "logging"

    @property
    def position(self) -> LogPosition:
        """Position up to which all data are with the operating system."""
        return LogPosition(self._folder.number, self._messages)

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return self._folder.path

    @property
    def holding(self) -> bool:
        """Whether a piece waits to be written."""
        return self._held is not None

    @property
    def shortage(self) -> str | None:
        """Why nothing could be written now: budget, free_space, or None. Deletes nothing."""
        open_bytes = 0 if self._writer is None else self._writer.size_bytes
        free = self._free_bytes(self._folder.path)
        return make_room(self.policy, self._folder.closed, open_bytes, _MARGIN, free).shortage

    @property
    def path(self) -> Path | None:
        """The file being written, None between files."""
        return None if self._writer is None else self._writer.path

    def write(
        self, data: bytes, arrival_ns: int, bounds: MessageBounds, *, gap_before: bool = False
    ) -> bool:
        """Record the next bytes of the sonar's stream; return True if all of them are recorded.

        Args:
            data: received bytes.
            arrival_ns: arrival time.
            bounds: message boundaries in the data, from `OculusSonar` or `StreamParser`. Whole
                messages have `MessageBounds(0, len(data))`.
            gap_before: bytes before these were lost, or this is a new connection.
        """
        self._pending = len(data) - bounds.end
        if self._torn:
            start = bounds.start
            self._torn = bounds.end < 0
            if start:
                self._drop("resuming", start)
            return self._put(_SONAR, data[start:], arrival_ns) and not start
        whole = max(0, bounds.end)
        full = self._full(arrival_ns)
        if full is None or not whole:
            return self._put(_SONAR, data, arrival_ns, gap_before=gap_before)
        done = self._put(_SONAR, data[:whole], arrival_ns, gap_before=gap_before)
        if self._held is not None:
            self._held = self._held._replace(data=data)
            return False
        self._finish(full)
        return self._put(_SONAR, data[whole:], arrival_ns) and done

    def write_status(self, datagram: bytes, arrival_ns: int) -> bool:
        """Record a status datagram; return True if it is recorded."""
        return self._put(_STATUS, datagram, arrival_ns)

    def write_other(
        self, link: str, data: bytes, arrival_ns: int, *, gap_before: bool = False
    ) -> bool:
        """Record bytes of another link of `others`; return True if they are recorded."""
        return self._put(link, data, arrival_ns, gap_before=gap_before)

    def retry(self, now_ns: int) -> bool:
        """Retry the held piece; return True if nothing is held any more."""
        held, self._held = self._held, None
        if held is None:
            return True
        return self._put(
            held.link, held.data, held.arrival_ns, gap_before=held.gap_before, now_ns=now_ns
        )

    def drop_held(self) -> None:
        """Drop the held piece and count it."""
        held, self._held = self._held, None
        if held is not None:
            self._refuse(held.link, self._paused_for, len(held.data))

    def tick(self, now_ns: int) -> None:
        """Perform timed work while no data arrive: close an old file, flush data to the disk."""
        full = self._full(now_ns)
        if full is not None and not self._pending:
            self._finish(full)
        self._sync_if_due(now_ns)

    def sync(self, now_ns: int) -> bool:
        """Flush all written data to the disk, where they survive a power cut.

        Args:
            now_ns: present time, on the clock of the arrivals.

        Returns:
            False if the disk failed. The log pauses, unless it failed for a closed file.
        """
        try:
            while self._unsynced:
                self._folder.sync_file(self._unsynced[0])
                self._unsynced.pop(0)
        except OSError as error:
            self.reason = str(error)
            return False
        if self._writer is None:
            return True
        try:
            self._writer.sync()
        except (RecordingError, OSError) as error:
            self._fail(error, now_ns)
            return False
        self._synced_ns = now_ns
        self.counters.syncs += 1
        return True

    def close(self) -> None:
        """Close the current file. May be called again; writing opens another file."""
        self.drop_held()
        self._finish(None)

    def _full(self, now_ns: int) -> str | None:
        if self._writer is None:
            return None
        full = self.policy.full(self._writer.size_bytes, now_ns - self._began_ns)
        return full or ("clock" if self._offset.has_changed(now_ns) else None)

    def _put(
        self,
        link: str,
        data: bytes,
        arrival_ns: int,
        *,
        gap_before: bool = False,
        now_ns: int | None = None,
    ) -> bool:
        if not data:
            return True
        now_ns = arrival_ns if now_ns is None else now_ns
        piece = _LogPiece(link, data, arrival_ns, gap_before)
        if self._retry_at_ns is not None and now_ns < self._retry_at_ns:
            return self._defer(piece, self._paused_for)
        try:
            shortage = self._room(len(data), now_ns)
            if shortage is not None:
                self._pause(shortage, shortage, now_ns)
                return self._defer(piece, shortage)
            self._write(piece, now_ns)
        except (RecordingError, OSError) as error:
            self._fail(error, now_ns)
            return self._defer(piece, "disk")
        self._retry_at_ns, self.reason = None, None
        self._gap = self._gap and link != _SONAR
        self.counters.bytes_written += len(data)
        self._sync_if_due(now_ns)
        return True

    def _write(self, piece: _LogPiece, now_ns: int) -> None:
        writer = self._writer or self._open(now_ns)
        gap = piece.gap_before or (piece.link == _SONAR and self._gap)
        writer.write(self._numbers[piece.link], piece.data, piece.arrival_ns, gap_before=gap)
        self._messages = writer.messages

    def _fail(self, error: Exception, now_ns: int) -> None:
        self._finish("failure")
        self._pause("disk", str(error), now_ns)

    def _defer(self, piece: _LogPiece, reason: str) -> bool:
        if not self._hold:
            return self._refuse(piece.link, reason, len(piece.data))
        self._held = piece
        return False

    def _pause(self, kind: str, reason: str, now_ns: int) -> None:
        self._paused_for = kind
        self.reason = reason
        self._retry_at_ns = now_ns + self.policy.retry_ns

    def _refuse(self, link: str, reason: str, size: int) -> bool:
        self._drop(reason, size)
        if link == _SONAR:
            self._torn = self._pending > 0
            self._gap = True
        return False

    def _drop(self, reason: str, size: int) -> None:
        self.counters.drops[reason] += 1
        self.counters.bytes_dropped += size

    def _room(self, size: int, now_ns: int) -> str | None:
        """Delete old files as needed; return why there still is no room, or None."""
        needed = size + _MARGIN
        open_bytes = 0 if self._writer is None else self._writer.size_bytes
        room = make_room(
            self.policy, self._folder.closed, open_bytes, needed, self._free_now(size, now_ns)
        )
        for file in room.delete:
            self._free = None
            if self._folder.delete(file):
                self.counters.files_deleted += 1
                self.counters.bytes_deleted += file.size_bytes
            else:
                self.counters.deletes_failed += 1
        return room.shortage

    def _free_now(self, size: int, now_ns: int) -> int:
        """Return the free space; queries the disk once per second and counts in between."""
        age_ns = now_ns - self._free_checked_ns
        if self._free is None or not 0 <= age_ns < _CHECK_INTERVAL_NS:
            self._free = self._free_bytes(self._folder.path)
            self._free_checked_ns = now_ns
        free = self._free
        self._free -= size
        return free

    def _open(self, now_ns: int) -> RecordingWriter:
        change_ns = self._offset.follow()
        note = {CLOCK_CHANGE: str(change_ns)} if change_ns else {}
        offset_ns = self._offset.ns
        path = self._folder.next_path(now_ns + offset_ns)
        try:
            writer = RecordingWriter(
                path, monotonic_to_unix_ns=offset_ns, metadata=self._metadata | note
            )
        except (RecordingError, OSError):
            self._folder.give_back(path)
            raise
        self._writer = writer
        self._messages = 0
        self._began_ns = self._synced_ns = now_ns
        self.counters.files_opened += 1
        self._numbers = {
            name: writer.add_link(name, encoding) for name, encoding in self._links.items()
        }
        if self.policy.sync_interval_ns is not None:
            self._folder.sync()
        return writer

    def _sync_if_due(self, now_ns: int) -> None:
        interval_ns = self.policy.sync_interval_ns
        if interval_ns is not None and now_ns - self._synced_ns >= interval_ns:
            self.sync(now_ns)

    def _finish(self, why: str | None) -> None:
        """Close the file. A file without room for its index is still readable."""
        writer, self._writer = self._writer, None
        if writer is None:
            return
        is_synced = False
        with suppress(RecordingError, OSError):
            if self.policy.sync_interval_ns is not None and why != "failure":
                writer.sync()
                is_synced = True
        with suppress(RecordingError, OSError):
            writer.close()
        if not is_synced:
            self._unsynced.append(writer.path)
        self._folder.add(writer.path)
        if why is not None:
            self.counters.rotations[why] += 1
