"""What the daemon takes of its computer: processor, memory, disk."""

import os
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

__all__ = ["Vitals"]

STATM = Path("/proc/self/statm")


class Vitals:
    """Asked every few seconds; each answer is about the time since the one before.

    Args:
        folders: whose disks matter.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = tuple(folders)
        self._last = (time.monotonic(), time.process_time())

    def __call__(self) -> dict[str, Any]:
        """`cpu_percent` (of one core), `memory_bytes` (resident), `disk_free_bytes` by folder."""
        now = (time.monotonic(), time.process_time())
        wall_s, cpu_s = (b - a for a, b in zip(self._last, now, strict=True))
        self._last = now
        return {
            "cpu_percent": round(100 * cpu_s / wall_s, 1) if wall_s > 0 else None,
            "memory_bytes": _resident_bytes(),
            "disk_free_bytes": {str(folder): _free_bytes(folder) for folder in self._folders},
        }


def _resident_bytes() -> int | None:
    try:
        pages = int(STATM.read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):  # not Linux
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _free_bytes(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None
