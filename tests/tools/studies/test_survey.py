"""The study's own judge: when two maps are the same, and what a run must hold."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from mapper_survey.engine import Done, InProcess
from mapper_survey.request import read_survey
from mapper_survey.run_record import TaskTime
from studies.survey.make_dives import write_survey as write_study
from studies.survey.run import Judged, Single, kill_every_s, main, verdicts_of
from studies.survey.runs import (
    Fingerprint,
    RunUsage,
    SchedulerTime,
    fingerprint,
    map_in_one_process,
    peak_bytes,
    time_of,
    watch,
)

from tests.tools.mapper_survey.dives import run_here, write_dive, write_survey

SAME, OTHER = Fingerprint(2, 2001, "ab"), Fingerprint(2, 2001, "cd")
MEMORY_BYTES = 2000


def test_the_map_of_one_process_is_the_survey_s_to_the_bit(tmp_path: Path) -> None:
    dives = [{"name": name, "recording": f"{name}.mcap"} for name in "ab"]
    survey = write_survey(tmp_path, dives=dives)
    write_dive(tmp_path / "b.mcap", 2, begin_s=60.0, y=3.0)
    record = run_here(survey, tmp_path / "out")
    recordings = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    config = read_survey(survey).config
    pings = map_in_one_process(recordings, config, tmp_path / "single.db")
    assert pings == record["pings"]
    whole = fingerprint(tmp_path / "out/map.db")
    assert whole == fingerprint(tmp_path / "single.db")
    assert whole.bricks == record["maps"][0]["bricks"] > 10
    assert whole.voxel_bytes > whole.bricks * 1000
    map_in_one_process(recordings[::-1], config, tmp_path / "turned.db")
    assert fingerprint(tmp_path / "turned.db") != whole


def judged(
    found: Fingerprint,
    wall_s: float = 10.0,
    killed: int = 0,
    lost: int = 0,
    peak: int = MEMORY_BYTES,
) -> Judged:
    reported: dict[str, list[object]] = {f"dive-{k}": ["cut"] for k in range(lost)}
    return Judged(RunUsage(2, wall_s, 1.0, peak, killed), 200.0, found, reported)


def hold(results: dict[str, Judged], single: Single, *, long: bool) -> bool:
    return all(verdicts_of(results, single, MEMORY_BYTES, long=long).values())


def test_all_that_a_survey_must_hold_is_looked_at() -> None:
    results = {
        "one": judged(SAME),
        "two": judged(SAME),
        "killed": judged(SAME, killed=1),
        "damaged": judged(OTHER, lost=2),
    }
    single = Single(1.0, 5, SAME)
    assert hold(results, single, long=True)
    wrong = {
        "one": judged(OTHER),
        "two": judged(OTHER),
        "killed": judged(OTHER, killed=1),
        "damaged": judged(OTHER, lost=1),
    }
    for name, result in wrong.items():
        assert not hold({**results, name: result}, single, long=False)
    greedy = judged(OTHER, lost=2, peak=MEMORY_BYTES + 1)
    assert not hold({**results, "damaged": greedy}, single, long=False)
    for name, result in (("two", judged(SAME, wall_s=10.1)), ("killed", judged(SAME))):
        assert not hold({**results, name: result}, single, long=True)
        assert hold({**results, name: result}, single, long=False)
    tiny = Fingerprint(2, MEMORY_BYTES, "ab")
    small = {name: judged(tiny, killed=1, lost=2) for name in results}
    assert not hold(small, Single(1.0, 5, tiny), long=True)
    assert hold(small, Single(1.0, 5, tiny), long=False)


class Busy(InProcess):
    """Loses a task, or takes its time for each."""

    def __init__(self, lost: int) -> None:
        super().__init__()
        self._lost = lost

    def done(self) -> Iterator[Done]:
        for each in list(super().done())[self._lost :]:
            until_s = time.process_time() + 0.003
            while time.process_time() < until_s:
                pass
            yield each


def test_the_scheduler_s_time_is_that_of_a_task() -> None:
    assert time_of(Busy(0), 20).ms >= 3.0
    with pytest.raises(RuntimeError, match="19 of 20 tasks ended"):
        time_of(Busy(1), 20)


def test_memory_that_was_taken_for_a_moment_is_seen_later() -> None:
    code = "import sys; bytearray(b'1') * (200 << 20); print(1, flush=True); sys.stdin.read()"
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:  # noqa: S603 our own
        assert other.stdout is not None
        other.stdout.readline()
        assert psutil.Process(other.pid).memory_info().rss < 100 << 20
        assert 200 << 20 < peak_bytes(other.pid) < 300 << 20
        other.kill()
        os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)
        assert peak_bytes(other.pid) == 0
        other.communicate()
    with pytest.raises(OSError, match="No such file"):
        peak_bytes(other.pid)


def test_workers_live_long_enough_for_the_longest_task() -> None:
    def task(cpu_s: float) -> TaskTime:
        return TaskTime(kind="tile", name="t", cpu_s=cpu_s, read_bytes=0, written_bytes=0)

    assert kill_every_s([task(3.0), task(29.0), task(1.0)], 60.0) == 60.0
    assert kill_every_s([task(3.0), task(200.0), task(1.0)], 60.0) == 400.0


@pytest.mark.slow
def test_a_run_that_failed_is_no_result(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="ended with 66"):
        watch(tmp_path / "none.yaml", tmp_path / "out", 0, "1GiB")


@pytest.mark.slow
def test_the_study_goes_through_to_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dives = [tmp_path / f"dives/{name}.mcap" for name in "abc"]
    for number, path in enumerate(dives):
        write_dive(path, number, pings=8, begin_s=60.0 * number)

    def made(out: Path, *_: object) -> list[Path]:
        write_study(out, dives)
        return dives

    def watched(survey: Path, out: Path, workers: int, *_: object, **__: object) -> RunUsage:
        run_here(survey, out)
        return RunUsage(workers, 1.0, 1.0, 1, 0)

    monkeypatch.setattr("studies.survey.run.make", made)
    monkeypatch.setattr("studies.survey.run.watch", watched)
    monkeypatch.setattr("studies.survey.run.scheduler_time", lambda: SchedulerTime(1.0))
    words = ["--out", str(tmp_path), "--scale", "small"]
    assert [main(words), main(words)] == [0, 0]
    assert "FAILS" not in capsys.readouterr().out
    reported = json.loads((tmp_path / "study.json").read_text("utf-8"))
    assert reported["one"]["map"] == reported["killed"]["map"] == reported["single"]["map"]
    assert reported["damaged"]["lost"].keys() == {"a", "b"}
    assert (tmp_path / "scaling/scaling.json").exists()
