"""The merged map: how far it is, and whether what is there is still what was merged."""

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from mapper_survey.command import main
from mapper_survey.engine import InProcess
from mapper_survey.folder import Folder
from mapper_survey.request import read_survey
from mapper_survey.running import RunOptions, run_survey

from tests.tools.mapper_survey.dives import MEMORY, rows_in, run_here, write_dive, write_survey


class Terminal(io.StringIO):
    """Shows everything."""

    def isatty(self) -> bool:
        return True


def short_survey(folder: Path, z: float = 0.0, **changes: Any) -> Path:
    """One dive of a second; returns `survey.yaml`."""
    dive = {"name": "a", "recording": "a.mcap", "transform": {"z": z}}
    survey = write_survey(folder, dives=[dive], **changes)
    write_dive(folder / "a.mcap", 1, pings=6)
    return survey


def test_the_merge_reports_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.cli.progress.TTY_PERIOD_S", 0.0)
    survey, out = write_survey(tmp_path, tile_size_m=12.8), Terminal()
    folder = Folder(str(tmp_path / "out"))
    record = run_survey(read_survey(survey), folder, InProcess(), RunOptions(MEMORY), out)
    tiles = record["maps"][0]["tiles"]
    shown = re.findall(r"([\d.]+) %  (\d+) shards  [\d.]+ shards/s", out.getvalue())
    expected = [(f"{100 * n / tiles:.1f}", str(n)) for n in range(1, tiles + 1)]
    assert tiles > 2
    assert shown == [*expected, expected[-1]]


@pytest.mark.parametrize("name", ["map.db", "dives/a.db"])
def test_a_map_that_is_not_what_was_merged_is_merged_again(tmp_path: Path, name: str) -> None:
    survey = short_survey(tmp_path)
    path = tmp_path / "out" / name
    run_here(survey, tmp_path / "out", by_dive=True)
    expected, damaged = rows_in(path), bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(damaged)
    run_here(survey, tmp_path / "out", by_dive=True)
    assert path.read_bytes() != damaged
    assert rows_in(path) == expected


@pytest.mark.parametrize("suffix", ["-wal", "-journal", "-shm"])
def test_a_map_that_somebody_began_to_change_is_merged_again(tmp_path: Path, suffix: str) -> None:
    survey = short_survey(tmp_path)
    path = tmp_path / "out/map.db"
    run_here(survey, tmp_path / "out")
    expected, before = rows_in(path), path.stat().st_ino
    beside = path.with_name(f"map.db{suffix}")
    beside.write_bytes(b"left by one who was killed")
    run_here(survey, tmp_path / "out")
    assert not beside.exists()
    assert path.stat().st_ino != before
    assert rows_in(path) == expected


def stopped_before(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run ends before a file or the record of a map takes its place."""
    put = Folder.put

    def stopping(self: Folder, path: Path, at: str) -> None:
        if at == name:
            raise KeyboardInterrupt
        put(self, path, at)

    monkeypatch.setattr(Folder, "put", stopping)


def export(out: Path) -> int:
    return main(["export", str(out), "--products", "soundings"])


@pytest.mark.parametrize("name", ["map.db", "map.json", "dives/a.json", "survey.json"])
def test_a_record_never_reports_of_another_map(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    run_here(short_survey(tmp_path), out, by_dive=True)
    assert export(out) == 0
    origin = {"latitude": 53.5, "longitude": 8.1, "altitude": 1.0}
    survey = short_survey(tmp_path, z=-1.0, origin=origin)
    with pytest.MonkeyPatch.context() as patch:
        stopped_before(name, patch)
        with pytest.raises(KeyboardInterrupt):
            run_here(survey, out, by_dive=True)
    assert not (out / "survey.json").exists()
    assert export(out) == 2
    assert "mapper-survey run" in capsys.readouterr().err
    run_here(survey, out, by_dive=True)
    assert json.loads((out / "survey.json").read_text("utf-8"))["origin"] == origin
    assert export(out) == 0


def test_a_record_of_maps_that_are_no_more_is_removed_before_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = short_survey(tmp_path)
    run_here(survey, tmp_path / "out", by_dive=True)
    stopped_before("survey.json", monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        run_here(survey, tmp_path / "out")
    assert not (tmp_path / "out/dives/a.db").exists()
    assert not (tmp_path / "out/survey.json").exists()


def test_a_run_that_changes_no_map_leaves_the_record_until_it_has_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = short_survey(tmp_path)
    run_here(survey, tmp_path / "out")
    before = (tmp_path / "out/survey.json").read_bytes()
    stopped_before("survey.json", monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        run_here(survey, tmp_path / "out")
    assert (tmp_path / "out/survey.json").read_bytes() == before
