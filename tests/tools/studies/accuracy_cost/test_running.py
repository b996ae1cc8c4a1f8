"""A run measures what is missing, and nothing that a setting does ends the rest."""

import multiprocessing
import re
from pathlib import Path

import pytest
from studies.accuracy_cost import running
from studies.accuracy_cost.results import Key, read_results
from studies.accuracy_cost.running import Job, MeasurementTally, outcomes, run, wanted_keys
from studies.accuracy_cost.study import DEFAULT, AccuracyCostError, Selection, Study

QUICK = Selection(quick=True)


@pytest.fixture(autouse=True)
def _known_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "commit", lambda: "abc")


def measured(out: Path) -> list[str]:
    """Settings in the order in which they were measured, on all dives."""
    return [
        line
        for log in sorted(out.glob("dives/abc/fake/*/measured"))
        for line in log.read_text().splitlines()
    ]


def run_fake(fake: Study, out: Path, selection: Selection = QUICK) -> MeasurementTally:
    return run({"fake_study": fake}, selection, out, jobs=1)


def test_a_selection_measures_each_setting_once(fake: Study) -> None:
    everything = wanted_keys(fake, Selection())
    assert len(set(everything)) == len(everything) == 2 * 8
    assert everything[0] == Key("calm", 1, "default")
    assert Key("storm", 2, "old=1") in everything
    assert [key.setting for key in wanted_keys(fake, QUICK)] == [
        "default", "size=0.5", "size=2", "size=3",
    ]  # fmt: skip
    of_a_knob = wanted_keys(fake, Selection(knobs=("way",)))
    assert {key.setting for key in of_a_knob} == {"default", "way=slow", "way=good", "way=none"}
    assert {key.dive for key in of_a_knob} == {"calm", "storm"}


def test_a_run_goes_on_where_it_was_stopped(fake: Study, tmp_path: Path) -> None:
    assert run_fake(fake, tmp_path) == MeasurementTally(4, 0, 0)
    assert sorted(measured(tmp_path)) == ["", "size=0.5", "size=2", "size=3"]
    file = tmp_path / "fake.csv"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-1]) + lines[-1][:-4])
    assert run_fake(fake, tmp_path) == MeasurementTally(4, 3, 0)
    assert len(measured(tmp_path)) == 5
    assert lines[-1] in file.read_text()
    assert run_fake(fake, tmp_path) == MeasurementTally(4, 4, 0)
    assert len(measured(tmp_path)) == 5


def test_a_setting_that_fails_is_one_line_and_the_rest_goes_on(
    fake: Study,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("FAKE_0.5", "raises")
    monkeypatch.setenv("FAKE_2", "dies")
    monkeypatch.setenv("FAKE_3", "forgets")
    assert run_fake(fake, tmp_path) == MeasurementTally(4, 0, 3)
    stated = sorted(capsys.readouterr().err.splitlines())
    assert len(stated) == 3
    assert stated[0] == "fake: calm (size=0.5) ValueError: no such setting"
    assert re.fullmatch(r"fake: calm \(size=2\) .*SIGKILL", stated[1])
    assert re.fullmatch(r"fake: calm \(size=3\) .*: cpu_ms, share", stated[2])
    assert set(read_results(tmp_path / "fake.csv").rows) == {Key("calm", 1, "default")}


def test_a_dive_that_cannot_be_prepared_fails_all_its_settings_and_no_others(
    fake: Study,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("FAKE_UNPREPARED", "storm")
    assert run_fake(fake, tmp_path, Selection(knobs=("size",))) == MeasurementTally(8, 0, 4)
    assert re.fullmatch("fake: storm .*OSError: no sea\n", capsys.readouterr().err)
    assert {key.dive for key in read_results(tmp_path / "fake.csv").rows} == {"calm"}


def test_a_process_that_takes_too_long_is_ended(
    fake: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_default", "hangs")
    (tmp_path / "prepared").touch()
    slow = Job("fake_study", fake.dives[0], DEFAULT, tmp_path)
    assert [o.failure for o in outcomes([slow], 2, longest_s=0.2)] == ["not done after 0.2 s"]
    assert multiprocessing.active_children() == []


def test_processes_end_when_nobody_wants_more_outcomes(fake: Study, tmp_path: Path) -> None:
    job = Job("fake_study", fake.dives[0], None, tmp_path)
    wanted = outcomes([job] * 3, 2)
    assert next(wanted).figures == {}
    assert multiprocessing.active_children()
    wanted.close()
    assert multiprocessing.active_children() == []


def test_two_runs_do_not_write_to_one_folder(fake: Study, tmp_path: Path) -> None:
    with running._alone(tmp_path), pytest.raises(AccuracyCostError, match="another run writes"):
        run_fake(fake, tmp_path)
