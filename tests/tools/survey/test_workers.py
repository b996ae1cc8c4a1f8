"""Dask's workers make the same map, however often they die. The one test that begins a cluster."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from survey.engine import Done
from survey.engine_dask import DaskEngine, local_pool, on_scheduler
from survey.errors import SurveyError
from survey.folder import Folder
from survey.request import read_survey
from survey.running import Options, run_survey

from tests.tools.survey.dives import MEMORY, Silent, rows_in, run_here, write_survey


class Killing:
    """Kills a worker while the other works, and later has none left."""

    def __init__(self, engine: DaskEngine) -> None:
        self.killed = 0
        self._engine = engine
        self._ended = 0

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:
        self._engine.submit(function, task)

    def done(self) -> Iterator[Done]:
        for each in self._engine.done():
            if self._ended == 0:
                self._kill()
            elif self._ended == 4:
                assert self._engine._cluster is not None
                self._engine._cluster.scale(0)
            self._ended += 1
            yield each

    def close(self) -> None: ...

    def _kill(self) -> None:
        assert self._engine._cluster is not None
        nannies = list(self._engine._cluster.workers.values())
        process = nannies[self.killed % len(nannies)].process
        os.kill(process.pid, signal.SIGKILL)
        self.killed += 1


def fails(_: object) -> None:
    raise SurveyError("cannot be done")


def test_killed_workers_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("survey.engine_dask.LOOK_S", 0.2)
    survey = write_survey(tmp_path, tile_size_m=12.8)
    request, options = read_survey(survey), Options(MEMORY)
    run_here(survey, tmp_path / "here")
    engine = local_pool(2, MEMORY)
    try:
        killing = Killing(engine)
        run_survey(request, Folder(str(tmp_path / "out")), killing, options, Silent())  # type: ignore[arg-type]
        assert killing.killed == 1
        assert engine._cluster is not None
        theirs = on_scheduler(engine._cluster.scheduler_address)
        run_survey(request, Folder(str(tmp_path / "more")), theirs, options, Silent())  # type: ignore[arg-type]
        theirs.submit(fails, 1)
        with pytest.raises(SurveyError, match="cannot be done"):
            list(theirs.done())
        theirs.close()
    finally:
        engine.close()
    expected = rows_in(tmp_path / "here/map.db")
    assert rows_in(tmp_path / "out/map.db") == expected
    assert rows_in(tmp_path / "more/map.db") == expected
