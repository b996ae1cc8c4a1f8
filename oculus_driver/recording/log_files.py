"""Files of a log: retention policy, names and deletion."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oculus_driver.errors import RecordingError, RecordingUnwritableError

if TYPE_CHECKING:
    from collections.abc import Iterable


MIB: Final = 1 << 20
_MIN_FILE: Final = MIB
_NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class LogPolicy:
    """Limits of a log.

    Attributes:
        max_file_bytes: a file is closed at the first end of a message beyond this; at least 1 MiB.
        max_file_ns: the same for the time since its first bytes; None: no limit.
        budget_bytes: maximum size of all files of the log, None: no limit. The oldest are deleted
            first. At least two files' worth.
        free_floor_bytes: minimum free space on the disk. Old files are deleted for it; when none is
            left, recording pauses until there is room.
        sync_interval_ns: interval of flushing to the disk, the maximum loss in a power failure.
            0: with every write; None: left to the operating system.
        retry_ns: pause after a disk error or a full disk.

    Raises:
        RecordingError: a limit is outside its range, or limits contradict each other.
    """

    max_file_bytes: int = 512 * MIB
    max_file_ns: int | None = None
    budget_bytes: int | None = None
    free_floor_bytes: int = 1024 * MIB
    sync_interval_ns: int | None = 5 * _NS_PER_S
    retry_ns: int = _NS_PER_S

    def __post_init__(self) -> None:
        if self.max_file_bytes < _MIN_FILE:
            raise RecordingError(f"max_file_bytes {self.max_file_bytes}: give at least 1 MiB")
        if self.max_file_ns is not None and self.max_file_ns < _NS_PER_S:
            raise RecordingError(f"max_file_ns {self.max_file_ns}: give at least one second")
        if self.budget_bytes is not None and self.budget_bytes < 2 * self.max_file_bytes:
            raise RecordingError(
                f"budget_bytes {self.budget_bytes}: too small for two files of "
                f"{self.max_file_bytes} bytes; raise it or lower max_file_bytes"
            )
        if min(self.free_floor_bytes, self.sync_interval_ns or 0, self.retry_ns) < 0:
            raise RecordingError("a limit of a log is negative")

    def full(self, size_bytes: int, age_ns: int) -> str | None:
        """Return why a file of this size and age must be closed, "size" or "time", or None."""
        if size_bytes >= self.max_file_bytes:
            return "size"
        too_old = self.max_file_ns is not None and age_ns >= self.max_file_ns
        return "time" if too_old else None


@dataclass(frozen=True, slots=True, order=True)
class LogFile:
    """A closed file of a log, ordered by number, oldest first."""

    number: int
    name: str
    size_bytes: int


@dataclass(frozen=True, slots=True)
class RetentionPlan:
    """What to do before bytes can be written.

    Attributes:
        delete: closed files to delete, oldest first.
        shortage: why the bytes still cannot be written: "budget", "free_space", or None.
    """

    delete: tuple[LogFile, ...]
    shortage: str | None


def make_room(
    policy: LogPolicy, closed: Iterable[LogFile], open_bytes: int, needed: int, free_bytes: int
) -> RetentionPlan:
    """Plan the deletions that make room for more bytes.

    Args:
        policy: the limits.
        closed: all closed files of the log.
        open_bytes: size of the current file, which is never deleted.
        needed: bytes to write.
        free_bytes: free space of the disk.
    """
    files = sorted(closed)
    used = sum(file.size_bytes for file in files) + open_bytes + needed
    free = free_bytes - needed
    budget = policy.budget_bytes
    delete: list[LogFile] = []
    for file in files:
        if (budget is None or used <= budget) and free >= policy.free_floor_bytes:
            break
        delete.append(file)
        used -= file.size_bytes
        free += file.size_bytes
    if free < policy.free_floor_bytes:
        return RetentionPlan(tuple(delete), "free_space")
    return RetentionPlan(tuple(delete), "budget" if budget is not None and used > budget else None)


_NAME: Final = re.compile(r"[A-Za-z0-9-]{1,64}")
_LAST_SECOND: Final = 253_402_300_799
"""End of the year 9999, the last one that a name can represent."""


def free_bytes_of(folder: Path) -> int:
    """Return the space that an ordinary user may still use on the folder's disk."""
    facts = os.statvfs(folder)
    return facts.f_bavail * facts.f_frsize


class LogFolder:
    """Files named `PREFIX_NUMBER_UTC.mcap`; numbers increase regardless of the clock.

    Only files with exactly such names are counted or deleted.

    Args:
        path: created if it does not exist.
        prefix: of the names: letters, digits, hyphens.

    Raises:
        RecordingError: the folder cannot be created or listed, or the prefix is invalid.
    """

    def __init__(self, path: str | os.PathLike[str], prefix: str) -> None:
        if not _NAME.fullmatch(prefix):
            raise RecordingError(f"prefix {prefix!r}: use letters, digits and hyphens only")
        self.path = Path(path)
        self.closed: list[LogFile] = []
        self._prefix = prefix
        self._pattern = re.compile(rf"{prefix}_(\d{{6,}})_\d{{8}}T\d{{6}}Z\.mcap")
        try:
            _make_folder(self.path)
            for entry in os.scandir(self.path):
                match = self._pattern.fullmatch(entry.name)
                if match is not None and entry.is_file(follow_symlinks=False):
                    size = entry.stat(follow_symlinks=False).st_size
                    self.closed.append(LogFile(int(match[1]), entry.name, size))
        except OSError as error:
            reason = error.strerror or str(error)
            text = f"{path}: cannot use the folder for a log: {reason}"
            raise RecordingUnwritableError(text) from error
        self._number = max((file.number for file in self.closed), default=0)

    @property
    def number(self) -> int:
        """Number of the newest file; 0 before the first."""
        return self._number

    def next_path(self, unix_ns: int) -> Path:
        """Return the path of a new file that starts at this time."""
        self._number += 1
        start = datetime.fromtimestamp(min(max(unix_ns, 0) // _NS_PER_S, _LAST_SECOND), UTC)
        return self.path / f"{self._prefix}_{self._number:06d}_{start:%Y%m%dT%H%M%SZ}.mcap"

    def give_back(self, path: Path) -> None:
        """Use the newest number again if its file could not be created."""
        if not path.exists():
            self._number -= 1

    def add(self, path: Path) -> None:
        """Add the newest file to the closed ones."""
        try:
            size = path.stat().st_size
        except OSError:  # deleted by another program
            return
        self.closed.append(LogFile(self._number, path.name, size))

    def delete(self, file: LogFile) -> bool:
        """Delete a closed file and forget it; return False if the deletion failed."""
        self.closed.remove(file)
        try:
            (self.path / file.name).unlink(missing_ok=True)
        except OSError:
            return False
        return True

    def sync(self) -> None:
        """Flush the names of new files to the disk."""
        _sync_folder(self.path)

    @staticmethod
    def sync_file(path: Path) -> None:
        """Flush the data of a closed file to the disk, unless it was deleted."""
        with suppress(FileNotFoundError), path.open("rb") as file:
            os.fdatasync(file.fileno())


def _make_folder(path: Path) -> None:
    """Create a folder and its parents, and flush their names to the disk."""
    if path.is_dir():
        return
    if path.parent != path:
        _make_folder(path.parent)
    path.mkdir(exist_ok=True)
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    number = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(number)
    finally:
        os.close(number)
