"""Truncated or damaged recordings: the intact part is used, losses are reported."""

import errno
import json
import re
from pathlib import Path
from typing import Any

import pytest
from mapper_survey.command import main
from mapper_survey.errors import SurveyError
from mapper_survey.request import read_survey

from tests.tools.mapper_survey.dives import rows_in, run_here, write_dive, write_survey

ALONE: list[dict[str, Any]] = [{"name": "a", "recording": "a.mcap"}]


def run_on(folder: Path, data: bytes) -> dict[str, Any]:
    survey = write_survey(folder, dives=ALONE)
    (folder / "a.mcap").write_bytes(data)
    return run_here(survey, folder / "out")


def test_a_cut_recording_counts_up_to_the_cut(tmp_path: Path) -> None:
    sizes = write_dive(tmp_path / "a.mcap", 1)
    data = (tmp_path / "a.mcap").read_bytes()[: sizes[20] - 5]
    record = run_on(tmp_path, data)
    (dive,) = record["dives"]
    (lost,) = dive["lost"]
    assert dive["pings"] == 20
    assert lost["truncated"]
    assert lost["bytes_read"] <= lost["size_bytes"] == len(data)
    undamaged = write_survey(tmp_path / "short", dives=ALONE)
    write_dive(tmp_path / "short/a.mcap", 1, pings=20)
    run_here(undamaged, tmp_path / "short/out")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "short/out/map.db")


def test_turned_bits_cost_what_they_hit(tmp_path: Path) -> None:
    sizes = write_dive(tmp_path / "a.mcap", 1, synced=5)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    part = slice(sizes[9], sizes[11])
    data[part] = bytes(value ^ 0xFF for value in data[part])
    record = run_on(tmp_path, bytes(data))
    (dive,) = record["dives"]
    assert 8 <= dive["pings"] < 30
    assert dive["lost"]
    assert dive["lost"][0]["reason"]


def test_pings_that_never_came_are_counted_by_dive(tmp_path: Path) -> None:
    dives = [{"name": "a", "recording": "a.mcap"}, {"name": "b", "recording": "b.mcap"}]
    survey = write_survey(tmp_path, dives=dives)
    write_dive(tmp_path / "a.mcap", 1, pings=12, never=(3, 7, 8))
    sizes = write_dive(tmp_path / "b.mcap", 2, pings=12, never=(5,))
    data = (tmp_path / "b.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[: sizes[9] - 5])
    first, second = run_here(survey, tmp_path / "out")["dives"]
    assert (first["pings"], first["pings_lost"], first["lost"]) == (9, 3, [])
    assert first["last_ns"] - first["first_ns"] == pytest.approx(11 * 0.2e9, abs=1e6)
    assert (second["pings"], second["pings_lost"], len(second["lost"])) == (8, 1, 1)


def test_what_is_no_recording_is_lost_as_a_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dives = [*ALONE, {"name": "gone", "recording": "gone.mcap"}, {"name": "x", "recording": "x"}]
    survey = write_survey(tmp_path, dives=dives)
    (tmp_path / "gone.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "x").mkdir()
    words = ["run", str(survey), "--out", str(tmp_path / "out"), "--workers", "0"]
    assert main(words) == 3
    assert main(["plan", *words[1:]]) == 3
    stated = capsys.readouterr()
    assert "30 pings of 6 s: " in stated.out
    for dive, file in (("gone", "gone.mcap"), ("x", "x")):
        assert f"mapper-survey: dive {dive}: {tmp_path / file}: " in stated.err
        assert re.search(
            rf"^mapper-survey: dive {dive}: (?!{re.escape(str(tmp_path))}).+$",
            stated.err,
            re.MULTILINE,
        )
    alone = write_survey(tmp_path / "alone", dives=ALONE)
    run_here(alone, tmp_path / "alone/out")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "alone/out/map.db")


def test_what_was_damaged_is_a_line_and_the_map_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = write_survey(tmp_path, dives=ALONE)
    sizes = write_dive(tmp_path / "a.mcap", 1)
    (tmp_path / "a.mcap").write_bytes((tmp_path / "a.mcap").read_bytes()[: sizes[20] - 5])
    out = tmp_path / "out"
    assert main(["run", str(survey), "--out", str(out), "--workers", "0"]) == 0
    stated = capsys.readouterr().err.splitlines()
    (line,) = [line for line in stated if line.startswith("mapper-survey: ")]  # no progress
    assert line.startswith(f"mapper-survey: dive a: {tmp_path / 'a.mcap'}: ")
    (dive,) = json.loads((out / "survey.json").read_text("utf-8"))["dives"]
    assert line.endswith(dive["lost"][0]["reason"])


def test_a_recording_that_is_gone_before_it_is_read_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = write_survey(tmp_path, dives=ALONE)
    request = read_survey(survey)
    monkeypatch.setattr("tests.tools.mapper_survey.dives.read_survey", lambda _: request)
    (tmp_path / "a.mcap").unlink()
    with pytest.raises(SurveyError, match=r"a\.mcap: "):
        run_here(survey, tmp_path / "out")


def refused(*_: object, **__: object) -> None:
    raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    "what",
    [
        "oculus_driver.recording.recording._open",
        "oculus_driver.recording.recording.detect_format",
        "oculus_driver.recording.mcap_reader._Reader.read",
        "mapper_survey.spool.RecordWriter.pack",
    ],
)
def test_what_a_disk_refuses_is_no_damage(tmp_path: Path, what: str) -> None:
    survey = write_survey(tmp_path, dives=ALONE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what, refused)
        with pytest.raises(OSError, match="Input/output error"):
            run_here(survey, tmp_path / "out")
    (dive,) = run_here(survey, tmp_path / "out")["dives"]
    assert dive["pings"] == 30
    assert not dive["lost"]
