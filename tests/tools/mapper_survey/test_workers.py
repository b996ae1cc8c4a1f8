"""Dask's workers make the same map, however often they die. The one test that begins a cluster."""

import asyncio
import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed import Status
from distributed.client import FutureCancelledError
from mapper_survey import engine_dask
from mapper_survey.engine import Done
from mapper_survey.engine_dask import (
    DaskEngine,
    Pool,
    done_by_worker,
    local_pool,
    on_scheduler,
    sent,
)
from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.request import read_survey
from mapper_survey.running import RunOptions, run_survey

from mapperd.errors import StoreError
from tests.tools.mapper_survey.dives import MEMORY, Silent, rows_in, run_here, write_survey


class Killing:
    """Kills a worker while the other works, and later has none left."""

    def __init__(self, engine: DaskEngine) -> None:
        self._engine = engine
        self._ended = 0

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:
        self._engine.submit(function, task)

    def done(self) -> Iterator[Done]:
        for each in self._engine.done():
            cluster = cluster_of(self._engine)
            if self._ended == 0:
                os.kill(next(n.pid for n in cluster.workers.values() if n.pid), signal.SIGKILL)
            elif self._ended == 4:
                cluster.scale(0)
            self._ended += 1
            yield each

    def close(self) -> None: ...


def cluster_of(engine: DaskEngine) -> Any:
    assert engine._pool is not None
    return engine._pool.cluster


def leave_one(cluster: Any) -> None:
    """One worker does all, as with --workers 1."""
    cluster.scale(1)
    while len(cluster.scheduler.workers) > 1:
        time.sleep(0.02)


def lose_a_result(engine: DaskEngine) -> None:
    """All workers die after a task ended and before anyone asks for its result."""
    engine.submit(str, 5)
    while engine._ended.empty():
        time.sleep(0.02)
    cluster_of(engine).scale(0)
    while cluster_of(engine).scheduler.workers:
        time.sleep(0.02)
    assert list(engine.done()) == [(5, "5")]


@contextlib.contextmanager
def first_worker_killed() -> Iterator[list[int]]:
    """Whatever worker begins first does not live to be there."""
    killed: list[int] = []
    over = threading.Event()

    def watch() -> None:
        while not killed and not over.wait(0.02):
            for process in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    if not killed and "spawn_main" in " ".join(process.cmdline()):
                        process.kill()
                        killed.append(process.pid)

    watching = threading.Thread(target=watch)
    watching.start()
    try:
        yield killed
    finally:
        over.set()
        watching.join()


def hears_interrupts(_: object) -> bool:
    return signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def fails(_: object) -> None:
    raise SurveyError("cannot be done")


def damaged(_: object) -> None:
    raise StoreError("a.db: is damaged", "damaged")


def faulty(_: object) -> None:
    raise ZeroDivisionError


@pytest.mark.crash
@pytest.mark.slow
def test_killed_workers_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engine_dask, "POLL_INTERVAL_S", 0.2)
    survey = write_survey(tmp_path, tile_size_m=12.8)
    request, options = read_survey(survey), RunOptions(MEMORY)
    run_here(survey, tmp_path / "here")
    with first_worker_killed() as killed:
        engine = local_pool(2, MEMORY)
    try:
        assert len(killed) == 1
        killing = Killing(engine)
        run_survey(request, Folder(str(tmp_path / "out")), killing, options, Silent())  # type: ignore[arg-type]
        assert len(cluster_of(engine).workers) == 2
        lose_a_result(engine)
        theirs = on_scheduler(cluster_of(engine).scheduler_address)
        leave_one(cluster_of(engine))
        run_survey(request, Folder(str(tmp_path / "more")), theirs, options, Silent())  # type: ignore[arg-type]
        assert len(cluster_of(engine).scheduler.workers) == 1
        theirs.submit(hears_interrupts, 1)
        assert list(theirs.done()) == [(1, False)]
        assert hears_interrupts(1)
        theirs.submit(fails, 1)
        with pytest.raises(SurveyError, match="cannot be done"):
            list(theirs.done())
        theirs.submit(damaged, 1)
        with pytest.raises(StoreError, match=r"a\.db: is damaged"):
            list(theirs.done())
        theirs.submit(faulty, 1)
        with pytest.raises(SurveyError, match="ZeroDivisionError"):
            list(theirs.done())
        with monkeypatch.context() as patch:
            patch.setattr("mapper_survey.engine_dask.program_digest", lambda: "another")
            theirs.submit(hears_interrupts, 1)
        with pytest.raises(SurveyError, match=r"worker .*mapperd .*\(program another\)"):
            list(theirs.done())
        cluster_of(engine).scale(0)
        monkeypatch.setattr(engine_dask, "ALONE_S", 0.5)
        theirs.submit(time.sleep, 1000)
        with pytest.raises(SurveyError, match=r"\b0\.5 s"):
            list(theirs.done())
        theirs.close()
    finally:
        engine.close()
    expected = rows_in(tmp_path / "here/map.db")
    assert rows_in(tmp_path / "out/map.db") == expected
    assert rows_in(tmp_path / "more/map.db") == expected
    assert capfd.readouterr().err == ""


def test_a_worker_of_another_program_refuses_before_it_unpacks_anything() -> None:
    their_version, digest, packed = sent(str, 3)
    assert done_by_worker((their_version, digest, packed)) == "3"
    with pytest.raises(SurveyError, match=r"worker .*mapperd .*9\.9"):
        done_by_worker(("9.9", "f" * 24, b"no pickle of mine"))


class Lost:
    """What a scheduler that is gone leaves behind."""

    def result(self, **_: float) -> None:
        raise FutureCancelledError("map_tile-1", "scheduler-connection-lost")


def test_a_lost_scheduler_is_reported_in_one_line() -> None:
    with pytest.raises(SurveyError, match="connection-lost"):
        engine_dask._result_of(Lost())


class Deadly:
    """A cluster whose workers die while they begin."""

    def __init__(self) -> None:
        self.workers: dict[int, Any] = {}
        self.worker_spec: dict[int, Any] = {}
        self.begun = 0
        self.interrupted = False

    def new_worker_spec(self) -> dict[int, Any]:
        return {len(self.worker_spec): None}

    def sync(self, function: Any) -> Any:
        if self.interrupted:
            self.interrupted = False
            raise KeyboardInterrupt
        return asyncio.run(function())

    def __await__(self) -> Iterator[None]:
        self.begun += 1
        dead = type("Nanny", (), {"status": Status.failed})
        self.workers = dict.fromkeys(self.worker_spec, dead)
        yield from ()
        raise RuntimeError("Nanny failed to start.")


def test_workers_that_always_die_end_the_run() -> None:
    cluster = Deadly()
    pool = Pool(cluster, 2)
    for _ in range(engine_dask.MAX_BEGUN - 1):
        pool.fill_up(reset=False)
    with pytest.raises(SurveyError, match=r"\b20 .*--workers 0"):
        pool.fill_up(reset=False)
    pool.fill_up(reset=True)


def test_an_interrupted_pool_is_not_left_half_begun() -> None:
    cluster = Deadly()
    pool = Pool(cluster, 2)
    cluster.interrupted = True
    with pytest.raises(KeyboardInterrupt):
        pool.fill_up(reset=True)
    assert cluster.begun == 2
