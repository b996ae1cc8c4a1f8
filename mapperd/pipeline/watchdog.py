"""Is the daemon alive? A loop that only ticks hides a thread that is stuck: work done counts."""

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Watchdog", "Worker"]


@dataclass(frozen=True, slots=True)
class Worker:
    """What one thread has to do, and has done.

    Attributes:
        name: for a person.
        waiting: pieces of work, the one in hand included.
        done: pieces finished since the start.
        held: why it waits on purpose, such as for a disk with room; empty if it does not.
    """

    name: str
    waiting: int
    done: int
    held: str = ""


class Watchdog:
    """Says whether every worker that has work gets on with it.

    Args:
        patience_s: so long one piece of work may take.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._seen: dict[str, tuple[int, float]] = {}

    def stuck(self, workers: Iterable[Worker], now_s: float) -> tuple[str, ...]:
        """Names of workers that have had work and finished none for too long.

        Args:
            workers: all of them, at each look.
            now_s: a clock that only goes forward.
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
