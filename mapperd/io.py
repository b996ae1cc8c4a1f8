"""Files that are either whole or not there, and locks between processes."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from mapperd.errors import ExportError, os_reason

__all__ = ["atomic_file", "lock_file", "make_folder", "remove", "sync_folder"]


def make_folder(folder: Path) -> None:
    """Make a folder for results, with its parents.

    Raises:
        ExportError: it cannot be made, or nothing can be written into it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ExportError(f"{folder}: cannot be written into: {os_reason(error)}") from error


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes its place only when all went well.

    A link that stands in its place, or in that of what is being written, is replaced, never
    followed.

    Raises:
        ExportError: it cannot be written; what stood there before is untouched.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)  # of somebody who was killed
        with partial.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {os_reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def sync_folder(folder: Path) -> None:
    """Bring a new name to the disk, where the file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def lock_file(
    path: Path, flags: int = os.O_RDWR | os.O_CREAT, mode: int = 0o600, *, wait: bool = False
) -> int:
    """Open a file or a folder, and lock it until the handle is closed or the process ends.

    Args:
        path: of the file.
        flags: of `os.open`.
        mode: of a file that is created.
        wait: wait for another process that holds the lock.

    Returns:
        The handle; close it with `os.close`.

    Raises:
        BlockingIOError: another process holds the lock.
        OSError: it cannot be opened or locked.
    """
    handle = os.open(path, flags | os.O_CLOEXEC, mode)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(handle)
        raise
    return handle


def remove(path: Path) -> None:
    """Remove a file, if it is there.

    Raises:
        ExportError: it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise ExportError(f"{path}: cannot be removed: {os_reason(error)}") from error
