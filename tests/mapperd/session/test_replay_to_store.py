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
    chunks, runs = 0, list[PipelineCounters]()

    def interrupt(counters: PipelineCounters) -> None:
        nonlocal chunks
        runs[-1] = counters
        chunks += 1
        if chunks % step == 0:
            raise StopError

    for _ in range(40):
        runs.append(PipelineCounters())
        try:
            map_into_store([recording], config, None, path, interrupt)
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
    chunks = 0

    def interrupt(_: PipelineCounters) -> None:
        nonlocal chunks
        chunks += 1
        if chunks % 17 == 0:
            raise StopError

    for _ in range(200):  # an attempt may end before the first save
        try:
            found = map_into_store([recording], config, None, tmp_path / "cut.map", interrupt)
        except StopError:
            continue
        break
    else:
        pytest.fail("no attempt came to the end")
    assert chunks > 4 * 17
    with closing(found[0]):
        assert found[0].sha256() == truth
    assert found[3] == rule
