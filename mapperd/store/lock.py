"""One writer a file, told before it has read anything; readers need no leave."""

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from mapperd.errors import StoreError

__all__ = ["only_writer"]


@contextlib.contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold a lock beside the file, which ends with the process however that ends.

    Raises:
        StoreError: another process has it, or the folder cannot be written into.
    """
    lock = path.with_name(f"{path.name}.lock")
    try:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        reason = "disk_full" if error.errno == errno.ENOSPC else "read_only"
        raise StoreError(f"{lock}: cannot be made: {error.strerror}", reason) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise StoreError(f"{path}: another mapperd maps into it", "in_use") from error
        yield
    finally:
        os.close(handle)
