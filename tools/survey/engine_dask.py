"""Dask's workers: a pool on this machine, or a cluster that is there already.

Tasks are plain functions of plain arguments, and write only files of their own that take their
place when they are whole: it does no harm to do one twice, and a worker may die at any time.
"""

from collections.abc import Callable, Iterator
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from survey.engine import Done
from survey.errors import SurveyError

__all__ = ["DaskEngine", "local_pool", "on_scheduler"]

RETRIES = 3
"""Of a task that failed, as when a disk or a network does not answer."""

ALLOWED_DEATHS = 10
"""Of workers while they did one task: Dask asks for another worker until then."""

QUIET = 30
"""Level of `logging` of the workers: what they lose is told by the survey."""


class DaskEngine:
    """Has tasks done by the workers of a scheduler.

    Args:
        client: connected.
        cluster: to be closed with it; None where it is somebody else's.
    """

    def __init__(self, client: Client, cluster: LocalCluster | None) -> None:
        self._client = client
        self._cluster = cluster
        self._tasks: dict[str, Any] = {}
        self._coming: as_completed | None = None

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 any task
        """Have a task done."""
        future = self._client.submit(function, task, retries=RETRIES, pure=False)
        self._tasks[future.key] = task
        if self._coming is None:
            self._coming = as_completed([future])
        else:
            self._coming.add(future)

    def done(self) -> Iterator[Done]:
        """Tasks as they end."""
        if self._coming is None:
            return
        for future in self._coming:
            yield self._tasks.pop(future.key), _result_of(future)
        self._coming = None

    def close(self) -> None:
        """Let the workers go."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()


def local_pool(workers: int, memory_bytes: int) -> DaskEngine:
    """Workers of our own: processes that are ended, and begun anew, when they take more memory."""
    dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED_DEATHS})
    cluster = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        memory_limit=memory_bytes,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=QUIET,
    )
    return DaskEngine(Client(cluster), cluster)


def on_scheduler(address: str) -> DaskEngine:
    """The workers of a scheduler that somebody has begun.

    Raises:
        SurveyError: nobody answers there.
    """
    try:
        return DaskEngine(Client(address), None)
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
