"""Detects stuck threads by their finished work; a running event loop proves nothing."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from mapperd import _core

__all__ = ["Watchdog", "Worker", "process_progress"]

IO_FILE = Path("/proc/self/io")

IO_PART = 1 << 16
"""Read or written bytes that count as one finished part; much more than `IO_FILE` itself."""


def process_progress() -> int:
    """Return a number that grows while this process computes, reads or writes; any thread."""
    return _core.finished_parts() + _io_bytes() // IO_PART


def _io_bytes() -> int:
    """Return how many bytes this process has read and written; 0 where the system does not count.

    This counts its calls, whether or not they reach the disk.
    """
    try:
        counts = dict(line.split(": ") for line in IO_FILE.read_text("ascii").splitlines())
        return int(counts["rchar"]) + int(counts["wchar"])
    except (OSError, ValueError, KeyError):
        return 0


@dataclass(frozen=True, slots=True)
class Worker:
    """Progress of one thread.

    Attributes:
        name: for a person.
        waiting: unfinished pieces of work.
        done: finished pieces since the start.
        held: why it waits intentionally, such as for a full disk; empty otherwise.
    """

    name: str
    waiting: int
    done: int
    held: str = ""


class Watchdog:
    """Finds workers that have work but make no progress.

    Args:
        timeout_s: maximum duration of one piece of work.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._seen: dict[str, tuple[int, float]] = {}

    def stuck(self, workers: Iterable[Worker], now_s: float) -> tuple[str, ...]:
        """Return the names of workers that had work and finished none for too long.

        Args:
            workers: all workers, each time.
            now_s: monotonic time.
        """
        names = []
        for worker in workers:
            done, since_s = self._seen.get(worker.name, (-1, now_s))
            if worker.done != done or not worker.waiting or worker.held:
                since_s = now_s
            self._seen[worker.name] = (worker.done, since_s)
            if now_s - since_s > self._timeout_s:
                names.append(worker.name)
        return tuple(names)
