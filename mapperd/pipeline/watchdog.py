"""Detects stuck threads by their finished work: a running event loop alone proves nothing."""

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Watchdog", "Worker"]


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
        patience_s: maximum duration of one piece of work.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
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
            if now_s - since_s > self._patience_s:
                names.append(worker.name)
        return tuple(names)
