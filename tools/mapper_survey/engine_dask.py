"""Runs tasks by Dask's workers: a pool on this machine, or an existing cluster.

Tasks are plain functions of plain arguments. They write only their own files, atomically, so a task
can run twice and a worker can die at any time.
"""

import asyncio
import contextlib
import logging
import pickle
import queue
import signal
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, Status
from distributed.scheduler import KilledWorker

from mapper_survey.engine import Done
from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import program_digest
from mapperd import __version__
from mapperd.errors import MapperdError

__all__ = ["DaskEngine", "Pool", "Sent", "done_by_worker", "local_pool", "on_scheduler", "sent"]


Sent = tuple[str, str, bytes]
"""Version and digest of the sender; function and task, unpacked only if these are equal."""


def sent(function: Callable[[Any], Any], task: Any) -> Sent:  # noqa: ANN401 any task
    """Return the message to a worker."""
    return __version__, program_digest(), pickle.dumps((function, task))


def done_by_worker(work: Sent) -> object:
    """Run a task in the worker.

    Raises:
        SurveyError: the worker has another program, so its shards would not be bit-exact.
    """
    their_version, their_digest, packed = work
    mine = program_digest()
    if mine != their_digest:
        raise SurveyError(
            f"a worker has mapperd {__version__} (program {mine[:8]}); allowed: the one of the "
            f"command, {their_version} (program {their_digest[:8]}), of the same package"
        )
    function, task = pickle.loads(packed)  # noqa: S301 from who began the workers
    return function(task)


RETRIES = 3
"""Attempts of a task that failed, for example because of a disk or a network."""

ALLOWED_DEATHS = 10
"""Deaths of workers during one task after which Dask gives up."""

POLL_INTERVAL_S = 5.0
"""Interval of checks whether all workers exist."""

ALONE_S = 600.0
"""Timeout without any worker; those of a cluster may take minutes to start."""

MAX_BEGUN = 10
"""Restarts of all workers of a pool while no task ends."""

OUR_WORKERS = {
    # Do not poll them a hundred times a second.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.gil.enabled": False,
    # Do not return freed memory at once: each ping needs as much again.
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": 1,
        "OPENBLAS_NUM_THREADS": 1,
        "MKL_NUM_THREADS": 1,
    },
}
"""Environment of the workers; with Dask's defaults planning takes twice as long."""

QUIET = logging.CRITICAL
"""Log level of Dask; the survey reports losses itself, and deaths of workers are not reported."""

GONE = {Status.closed, Status.failed}


class DaskEngine:
    """Runs tasks by the workers of a scheduler.

    Args:
        client: a connected client.
        pool: pool to fill and to close; None for workers of an existing cluster.
    """

    def __init__(self, client: Client, pool: "Pool | None") -> None:
        self._client, self._pool = client, pool
        self._tasks: dict[str, Any] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._seen_s = time.monotonic()

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 any task
        """Have a task done."""
        work = sent(function, task)
        future = self._client.submit(done_by_worker, work, retries=RETRIES, pure=False)
        self._tasks[future.key] = task
        future.add_done_callback(self._ended.put)

    def done(self) -> Iterator[Done]:
        """Tasks as they end."""
        looked_s = self._seen_s = time.monotonic()
        some_ended = False
        while self._tasks:
            future = None
            with contextlib.suppress(queue.Empty):
                future = self._ended.get(timeout=POLL_INTERVAL_S)
            if time.monotonic() - looked_s >= POLL_INTERVAL_S:
                self._look(some_ended=some_ended)
                looked_s, some_ended = time.monotonic(), False
            if future is None:
                continue
            try:
                result = _result_of(future)
            except _ResultLost:
                self._ended.put(future)
                continue
            some_ended = True
            yield self._tasks.pop(future.key), result

    def close(self) -> None:
        """Let the workers go."""
        self._client.close()
        if self._pool is not None:
            self._pool.close()

    def _look(self, *, some_ended: bool) -> None:
        """Make sure that there are workers.

        Raises:
            SurveyError: no worker exists and none appears.
        """
        if self._pool is not None:
            self._pool.fill_up(reset=some_ended)
        elif some_ended or self._client.scheduler_info()["workers"]:
            self._seen_s = time.monotonic()
        elif time.monotonic() - self._seen_s > ALONE_S:
            raise SurveyError(
                f"{self._client.scheduler.address}: no worker for {ALONE_S:g} s; allowed: begin "
                "some; the same command then resumes"
            )


class Pool:
    """Keeps a number of workers on this machine.

    Dask's nannies restart workers that die, but not those that die during their start.

    Args:
        cluster: a cluster without workers.
        workers: number of workers.
    """

    def __init__(self, cluster: LocalCluster, workers: int) -> None:
        self.cluster = cluster
        self._workers = workers
        self._begun = 0
        self.fill_up(reset=True)

    def fill_up(self, *, reset: bool) -> None:
        """Start missing workers.

        Args:
            reset: reset the count of starts, because tasks end.

        Raises:
            SurveyError: they keep dying at their start.
        """
        self._begun = 0 if reset else self._begun
        if self._begun >= MAX_BEGUN * self._workers:
            raise SurveyError(
                f"workers die before they do anything: {self._begun} of them; allowed: --workers 0 "
                "does all in one process and reports what is wrong"
            )
        try:
            self._begun += self.cluster.sync(self._fill_up)
        except KeyboardInterrupt:
            self.cluster.sync(self._begin)  # Dask cannot close a worker during its start
            raise

    async def _fill_up(self) -> int:
        cluster = self.cluster
        for name in [name for name, nanny in cluster.workers.items() if nanny.status in GONE]:
            del cluster.workers[name]
        while len(cluster.worker_spec) < self._workers:
            cluster.worker_spec.update(cluster.new_worker_spec())
        missing = len(cluster.worker_spec.keys() - cluster.workers.keys())
        if missing:
            await asyncio.shield(asyncio.ensure_future(self._begin()))
        return missing

    async def _begin(self) -> None:
        """Wait until all have started or died; deaths are noticed by the next check."""
        with contextlib.suppress(RuntimeError, OSError, TimeoutError):
            await self.cluster

    def close(self) -> None:
        """Release the workers."""
        self.cluster.close()


def local_pool(workers: int, memory_bytes: int) -> DaskEngine:
    """A pool of worker processes, restarted if they exceed their memory.

    Raises:
        SurveyError: none can be started.
    """
    dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED_DEATHS, **OUR_WORKERS})
    with _deaf_to_interrupts():
        cluster = LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            memory_limit=memory_bytes,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # with none, Dask takes a port that may be taken
            silence_logs=QUIET,
        )
    return DaskEngine(Client(cluster), Pool(cluster, workers))


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Block Ctrl-C in threads and processes started meanwhile.

    Ctrl-C reaches all processes of a terminal; the main process ends the others.
    """
    resource_tracker.ensure_running()  # started later, it would unblock the signal in its thread
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def on_scheduler(address: str) -> DaskEngine:
    """The workers of an existing scheduler.

    Raises:
        SurveyError: it does not answer.
    """
    try:
        return DaskEngine(Client(address), None)
    except (OSError, ValueError) as error:
        raise SurveyError(f"{address}: no Dask scheduler answers there: {error}") from error


class _ResultLost(Exception):  # noqa: N818 nothing failed
    """Run a task again whose result was lost with its worker."""


def _result_of(future: Future) -> object:
    try:
        return future.result(timeout=POLL_INTERVAL_S)
    except TimeoutError as error:
        if future.status == "error":  # the task's own
            raise
        raise _ResultLost from error
    except KilledWorker as error:
        raise SurveyError(
            f"{ALLOWED_DEATHS} workers died of the same task, most likely for want of memory: "
            f"allowed: a larger --memory-per-worker ({error})"
        ) from error
    except (SurveyError, MapperdError, OSError):
        raise
    except Exception as error:  # a scheduler that is gone has errors of its own, workers have any
        raise SurveyError(
            f"a task did not end: {type(error).__name__}: {error}; the same command resumes; "
            "--workers 0 does all in one process and reports what is wrong"
        ) from error
