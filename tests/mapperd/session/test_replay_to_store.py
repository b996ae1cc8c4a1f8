import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.config.tree import VisualizationConfig
from mapperd.pipeline.counters import PipelineCounters
from mapperd.session.replay_to_store import map_into_store
from tests.mapperd.session.crash import test_startup as sessions


class StopError(Exception):
    """Stands for the end of the process."""


class Interrupt:
    """Ends each attempt after some chunks, once a save of this attempt is in the file.

    Saves come from another thread, so without the wait a busy machine might never make progress.
    """

    def __init__(self, path: Path, chunks: int) -> None:
        self.path, self.chunks = path, chunks
        self.interrupted = 0
        self._begin()

    def __call__(self, counters: PipelineCounters) -> None:
        if counters is not self._counters:
            self._begin(counters)
        self._seen += 1
        if self._seen < self.chunks:
            return
        until_s = time.monotonic() + 0.2
        while time.monotonic() < until_s:
            if self._position() != self._before:
                self.interrupted += 1
                raise StopError
            time.sleep(0.001)

    def _begin(self, counters: PipelineCounters | None = None) -> None:
        self._counters, self._seen = counters, 0
        self._before = self._position()

    def _position(self) -> bytes | None:
        if not self.path.exists():
            return None
        with closing(sqlite3.connect(self.path)) as file:
            return bytes(file.execute("SELECT position FROM progress").fetchone()[0])


@pytest.mark.parametrize("step", [7, 23, 40])
def test_counts_of_a_run_that_resumes_add_up(
    tmp_path: Path,
    survey: Callable[..., list[Any]],
    write_recording: Callable[..., object],
    step: int,
) -> None:
    recording, path = tmp_path / "dive.mcap", tmp_path / "dive.map"
    write_recording(recording, survey(30))
    config = msgspec.structs.replace(
        sessions.config_of(tmp_path), visualization=VisualizationConfig(tile_save_interval=1e-4)
    )
    runs = list[PipelineCounters]()
    interrupt = Interrupt(path, step)

    def on_chunk(counters: PipelineCounters) -> None:
        if not runs or runs[-1] is not counters:
            runs.append(counters)
        interrupt(counters)

    for _ in range(40):
        try:
            map_into_store([recording], config, None, path, on_chunk)
        except StopError:
            continue
        break
    assert len(runs) > 1
    last = runs[-1]
    assert last.pings_total == last.pings_mapped + last.pings_dropped.total()
    assert last.pings_mapped < 30
    assert any(0 < run.pings_mapped < 30 for run in runs)


def test_map_of_the_arc_rule_that_resumes_is_that_of_the_whole_recording(tmp_path: Path) -> None:
    more = "mapping: {rule: arc}\nvisualization: {tile_save_interval: 0.0001}\n"
    config = sessions.config_of(tmp_path, more)
    recording = sessions.record(config, 1, "a", range(30))
    whole, _, _, rule = map_into_store([recording], config, None, tmp_path / "whole.map")
    with closing(whole):
        truth = whole.sha256()
    assert rule["surface_returns"] > 100
    assert truth == sessions.reference(config, "a")
    interrupt = Interrupt(tmp_path / "cut.map", 17)
    for _ in range(40):
        try:
            found = map_into_store([recording], config, None, tmp_path / "cut.map", interrupt)
        except StopError:
            continue
        break
    else:
        pytest.fail("no attempt came to the end")
    assert interrupt.interrupted > 1
    with closing(found[0]):
        assert found[0].sha256() == truth
    assert found[3] == rule
