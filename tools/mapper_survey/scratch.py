"""Folders on a disk of this machine, for files that SQLite writes.

A survey's folder may lie on another machine, where SQLite's locks are not to be relied on
(sqlite.org/faq.html, question 5).
"""

import contextlib
import fcntl
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from mapper_survey.this_system import this_system

__all__ = ["scratch"]

PREFIX = ".mapper-survey-scratch."
"""Nobody calls a folder of their own so; what follows is this machine, since its last start: others
may share the folder of all these, and do not see its locks."""

YOUNG_S = 60.0
"""Since a folder was changed: it may be between being made and being locked."""


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A folder of its own in the one that `TMPDIR` names; what the killed have left there goes."""
    base = Path(tempfile.gettempdir())
    machine = hashlib.blake2b(this_system().encode(), digest_size=8).hexdigest()
    prefix = f"{PREFIX}{machine}."
    _sweep(base, prefix)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=base) as temporary:
        handle = os.open(temporary, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield Path(temporary)
        finally:
            os.close(handle)


def _sweep(base: Path, prefix: str) -> None:
    """Remove folders whose owner is gone: a lock ends with the process that has it."""
    for path in base.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # somebody else's, or removed meanwhile
            if path.stat().st_mtime > time.time() - YOUNG_S:
                continue
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path)
            finally:
                os.close(handle)
