"""The files of one log in a folder: their names, what they take, and how they go."""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from oculus_driver.errors import RecordingError
from oculus_driver.recording.log_files import LogFile

_NAME: Final = re.compile(r"[A-Za-z0-9-]{1,64}")
_NS_PER_S: Final = 1_000_000_000
_LAST_SECOND: Final = 253_402_300_799
"""End of the year 9999, the last that a name can hold."""


def free_bytes_of(folder: Path) -> int:
    """Return what an ordinary user may still write to the folder's disk."""
    facts = os.statvfs(folder)
    return facts.f_bavail * facts.f_frsize


class LogFolder:
    """Files named `PREFIX_NUMBER_UTC.mcap`; numbers go up, whatever the clock does.

    Only files with exactly such names are counted or deleted.

    Args:
        path: is made if it does not exist.
        prefix: of the names: letters, digits, hyphens.

    Raises:
        RecordingError: the folder cannot be made or listed, or the prefix is no such word.
    """

    def __init__(self, path: str | os.PathLike[str], prefix: str) -> None:
        if not _NAME.fullmatch(prefix):
            raise RecordingError(f"{prefix!r}: use letters, digits and hyphens for a log's name")
        self.path = Path(path)
        self.closed: list[LogFile] = []
        self._prefix = prefix
        self._pattern = re.compile(rf"{prefix}_(\d{{6,}})_\d{{8}}T\d{{6}}Z\.mcap")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            for entry in os.scandir(self.path):
                match = self._pattern.fullmatch(entry.name)
                if match is not None and entry.is_file(follow_symlinks=False):
                    size = entry.stat(follow_symlinks=False).st_size
                    self.closed.append(LogFile(int(match[1]), entry.name, size))
        except OSError as error:
            reason = error.strerror or str(error)
            raise RecordingError(f"{path}: no folder for a log: {reason}") from error
        self._number = max((file.number for file in self.closed), default=0)

    @property
    def number(self) -> int:
        """Of the newest file; 0 before the first."""
        return self._number

    def next_path(self, unix_ns: int) -> Path:
        """Return the path of a new file that begins at this time."""
        self._number += 1
        start = datetime.fromtimestamp(min(max(unix_ns, 0) // _NS_PER_S, _LAST_SECOND), UTC)
        return self.path / f"{self._prefix}_{self._number:06d}_{start:%Y%m%dT%H%M%SZ}.mcap"

    def add(self, path: Path) -> None:
        """Count the newest file as closed."""
        try:
            size = path.stat().st_size
        except OSError:  # somebody took it away
            return
        self.closed.append(LogFile(self._number, path.name, size))

    def delete(self, file: LogFile) -> bool:
        """Delete a closed file and forget it; False if it stays on the disk."""
        self.closed.remove(file)
        try:
            (self.path / file.name).unlink(missing_ok=True)
        except OSError:
            return False
        return True

    def sync(self) -> None:
        """Bring the names of new files to the disk."""
        number = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(number)
        finally:
            os.close(number)
