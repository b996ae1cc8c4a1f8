"""Dask's workers: a pool on this machine, or a cluster that is there already.

Tasks are plain functions of plain arguments, and write only files of their own that take their
place when they are whole: it does no harm to do one twice, and a worker may die at any time.
"""

import queue
from collections.abc import Callable, Iterator
from typing import Any

import dask
from distributed import Client, Future, LocalCluster
from distributed.scheduler import KilledWorker

from survey.engine import Done
from survey.errors import SurveyError

__all__ = ["DaskEngine", "local_pool", "on_scheduler"]

RETRIES = 3
"""Of a task that failed, as when a disk or a network does not answer."""

ALLOWED_DEATHS = 10
"""Of workers while they did one task: Dask asks for another worker until then."""

LOOK_S = 5.0
"""While nothing ends, so often it is asked whether there are workers."""

MOST_IDLE = 3
"""Looks without one: Dask begins a worker anew unless that died while it began."""

MOST_BEGINNINGS = 10
"""Of a pool, each of whose workers may die before it is there."""

QUIET = 50
"""Level of `logging` of the workers: what they lose is told by the survey."""


Begin = Callable[[], tuple[Client, LocalCluster | None]]


class DaskEngine:
    """Has tasks done by the workers of a scheduler.

    Args:
        begin: connects; a cluster that it returns is ours, and begun anew when it has no worker
            left and begins none itself.
    """

    def __init__(self, begin: Begin) -> None:
        self._begin = begin
        self._client, self._cluster = begin()
        self._tasks: dict[str, tuple[Callable[[Any], Any], Any]] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 any task
        """Have a task done."""
        future = self._client.submit(function, task, retries=RETRIES, pure=False)
        self._tasks[future.key] = function, task
        future.add_done_callback(self._ended.put)

    def done(self) -> Iterator[Done]:
        """Tasks as they end."""
        idle = 0
        while self._tasks:
            try:
                future = self._ended.get(timeout=LOOK_S)
            except queue.Empty:
                idle = 0 if self._has_workers() else idle + 1
                if idle == MOST_IDLE:
                    self._begin_anew()
                continue
            idle = 0
            if future.key in self._tasks:  # else of workers that are gone
                result = _result_of(future)
                yield self._tasks.pop(future.key)[1], result

    def close(self) -> None:
        """Let the workers go."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _has_workers(self) -> bool:
        return self._cluster is None or bool(self._client.scheduler_info()["workers"])

    def _begin_anew(self) -> None:
        tasks = list(self._tasks.values())
        self._tasks.clear()
        self.close()
        self._client, self._cluster = self._begin()
        for function, task in tasks:
            self.submit(function, task)


def local_pool(workers: int, memory_bytes: int) -> DaskEngine:
    """Workers of our own: processes that are ended, and begun anew, when they take more memory."""
    dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED_DEATHS})

    def begin() -> tuple[Client, LocalCluster]:
        failed: RuntimeError | None = None
        for _ in range(MOST_BEGINNINGS):
            try:
                return begin_once()
            except RuntimeError as error:  # a worker died while it began
                failed = error
        raise SurveyError(f"workers cannot begin, {MOST_BEGINNINGS} times: {failed}") from failed

    def begin_once() -> tuple[Client, LocalCluster]:
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=memory_bytes,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=QUIET,
        )
        return Client(cluster), cluster

    return DaskEngine(begin)


def on_scheduler(address: str) -> DaskEngine:
    """The workers of a scheduler that somebody has begun.

    Raises:
        SurveyError: nobody answers there.
    """
    try:
        return DaskEngine(lambda: (Client(address), None))
    except (OSError, ValueError) as error:
        raise SurveyError(f"{address}: no Dask scheduler answers there: {error}") from error


def _result_of(future: Future) -> object:
    try:
        return future.result()
    except KilledWorker as error:
        raise SurveyError(
            f"{ALLOWED_DEATHS} workers died of the same task, most likely for want of memory: "
            f"allowed: a larger --memory-per-worker ({error})"
        ) from error
