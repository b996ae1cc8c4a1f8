"""A survey resumes where it stopped, and repeats only what changed inputs affect."""

import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mapper_survey.command import main
from mapper_survey.engine import InProcess
from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.request import read_survey
from mapper_survey.running import RunOptions, run_survey

from tests.tools.mapper_survey.dives import (
    MEMORY,
    SETTINGS,
    Silent,
    rows_in,
    run_here,
    write_dive,
    write_survey,
)

pytestmark = pytest.mark.slow

KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from mapper_survey.folder import Folder
from tests.tools.mapper_survey.dives import run_here
left = int(sys.argv[4])
put = Folder.put
def counted(self, path, name):
    global left
    left -= 1
    if left < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    put(self, path, name)
Folder.put = counted
run_here(Path(sys.argv[1]), Path(sys.argv[2]))
"""
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[Any, ...]]]:
    folder = tmp_path_factory.mktemp("survey")
    survey = write_survey(folder, tile_size_m=12.8)
    run_here(survey, folder / "out")
    return survey, rows_in(folder / "out/map.db")


@pytest.mark.crash
@pytest.mark.parametrize("files", [1, 9])
def test_killed_between_any_two_files_it_goes_on(
    whole: tuple[Path, list[tuple[Any, ...]]], tmp_path: Path, files: int
) -> None:
    survey, expected = whole
    words = [sys.executable, "-c", KILLED, str(survey), str(tmp_path / "out")]
    done = subprocess.run(  # noqa: S603 our own
        [*words, str(ROOT / "tools"), str(files)], cwd=ROOT, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert not (tmp_path / "out/map.db").exists()
    assert list((tmp_path / "out/.work").iterdir())
    run_here(survey, tmp_path / "out")
    assert rows_in(tmp_path / "out/map.db") == expected
    assert not list((tmp_path / "out/.work").iterdir())


def changed_files(out: Path, before: dict[Path, int]) -> set[str]:
    return {
        str(path.relative_to(out))
        for path, at in stamps(out).items()
        if before.get(path) != at and not path.name.startswith(".")
    }


def stamps(out: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}


def test_done_work_is_not_done_again(tmp_path: Path) -> None:
    survey = write_survey(tmp_path, tile_size_m=12.8)
    first = run_here(survey, tmp_path / "out")
    before = stamps(tmp_path / "out")
    again = run_here(survey, tmp_path / "out")
    assert changed_files(tmp_path / "out", before) == {"survey.json"}
    assert again["tasks"] == first["tasks"]


def with_dive(survey: Path, name: str, begin_s: float) -> None:
    """Add a short dive to a survey."""
    write_dive(survey.parent / f"{name}.mcap", 3, pings=6, begin_s=begin_s, y=1.0)
    reported = json.loads(survey.read_text("utf-8"))
    reported["dives"].append({"name": name, "recording": f"{name}.mcap"})
    survey.write_text(json.dumps(reported), encoding="utf-8")


def test_a_later_dive_touches_only_its_own_tiles(tmp_path: Path) -> None:
    one = [{"name": "a", "recording": "a.mcap"}]
    survey = write_survey(tmp_path, dives=one, tile_size_m=6.4)
    run_here(survey, tmp_path / "out")
    with_dive(survey, "c", 100.0)
    before = stamps(tmp_path / "out")
    run_here(survey, tmp_path / "out")
    made = {name for name in changed_files(tmp_path / "out", before) if name.startswith("shards")}
    there = {f"shards/{path.name}" for path in (tmp_path / "out/shards").iterdir()}
    assert made
    assert there - made
    fresh = run_here(survey, tmp_path / "fresh")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "fresh/map.db")
    assert there == {f"shards/{path.name}" for path in (tmp_path / "fresh/shards").iterdir()}
    assert fresh["pings"] == 36


@pytest.mark.slow
def test_an_earlier_dive_gives_all_pings_other_numbers(tmp_path: Path) -> None:
    one = [{"name": "a", "recording": "a.mcap"}]
    survey = write_survey(tmp_path, dives=one, tile_size_m=6.4)
    run_here(survey, tmp_path / "out")
    with_dive(survey, "c", -100.0)
    run_here(survey, tmp_path / "out")
    run_here(survey, tmp_path / "fresh")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "fresh/map.db")


def test_maps_of_dives_that_are_no_more_are_removed(tmp_path: Path) -> None:
    survey = write_survey(tmp_path)
    run_here(survey, tmp_path / "out", by_dive=True)
    reported = json.loads(survey.read_text("utf-8"))
    survey.write_text(json.dumps(reported | {"dives": reported["dives"][:1]}), encoding="utf-8")
    for by_dive, left in ((True, {"a.db", "a.json"}), (False, set())):
        run_here(survey, tmp_path / "out", by_dive=by_dive)
        assert {path.name for path in (tmp_path / "out/dives").iterdir()} == left
    planned = sorted(path.name.split(".") for path in (tmp_path / "out/plan").iterdir())
    assert [(name, suffix) for name, _, suffix in planned] == [
        ("a", "json"),
        ("a", "npy"),
        ("a", "spool"),
    ]


def test_files_of_others_in_its_folder_stay(tmp_path: Path) -> None:
    theirs = {tmp_path / "dives/a.mcap", tmp_path / "dives/note.json", tmp_path / "plan/b.db"}
    for path in theirs:
        path.parent.mkdir(exist_ok=True)
        path.write_text("{}", encoding="utf-8")
    write_dive(tmp_path / "dives/a.mcap", 1)
    survey = write_survey(tmp_path, dives=[{"name": "a", "recording": "dives/a.mcap"}])
    run_here(survey, tmp_path)
    assert all(path.exists() for path in theirs)


@pytest.mark.parametrize("what", ["settings", "recording", "transform"])
def test_whatever_changes_makes_another_map(tmp_path: Path, what: str) -> None:
    dive: dict[str, Any] = {"name": "a", "recording": "a.mcap"}
    survey = write_survey(tmp_path, dives=[dive])
    run_here(survey, tmp_path / "out")
    before = rows_in(tmp_path / "out/map.db")
    settings = SETTINGS | ({"sonar": {"horizontal_fov": 60}} if what == "settings" else {})
    dive |= {"transform": {"x": 0.35}} if what == "transform" else {}
    reported = {"settings": settings, "dives": [dive]}
    survey.write_text(json.dumps(reported), encoding="utf-8")
    if what == "recording":
        write_dive(tmp_path / "a.mcap", 1, pings=20)
    run_here(survey, tmp_path / "out")
    run_here(survey, tmp_path / "fresh")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "fresh/map.db") != before


@pytest.mark.parametrize("stage", ["planning", "running"])
def test_what_a_stop_leaves_is_not_taken_for_what_was_there(
    whole: tuple[Path, list[tuple[Any, ...]]], tmp_path: Path, stage: str
) -> None:
    survey, expected = whole
    reported = json.loads(survey.read_text("utf-8"))
    reported["dives"][0] |= {"recording": str(survey.parent / "a.mcap")}
    reported["dives"][1] |= {"recording": str(survey.parent / "b.mcap")}
    mine = tmp_path / "survey.yaml"
    for shift_m in (0, 10, 0):
        reported["dives"][0]["transform"] = {"x": shift_m}
        mine.write_text(json.dumps(reported), encoding="utf-8")
        with pytest.MonkeyPatch.context() as patch:
            if shift_m:
                patch.setattr(f"mapper_survey.{stage}.mark", stopped)
                with pytest.raises(KeyboardInterrupt):
                    run_here(mine, tmp_path / "out")
                shutil.rmtree(tmp_path / "out/shards")
                if stage == "planning":  # what it leaves is seen in a map that is made again
                    (tmp_path / "out/map.db").unlink()
            else:
                run_here(mine, tmp_path / "out")
                assert rows_in(tmp_path / "out/map.db") == expected
    assert len(list((tmp_path / "out/plan").iterdir())) == 6


@pytest.mark.parametrize("name", ["plan/a.*.spool", "plan/a.*.npy", "shards/*.db", "map.db"])
@pytest.mark.parametrize("empty", [True, False])
def test_what_a_power_cut_damages_is_made_again(tmp_path: Path, name: str, empty: bool) -> None:  # noqa: FBT001 two ways
    survey = write_survey(tmp_path, dives=[{"name": "a", "recording": "a.mcap"}])
    out = tmp_path / "out"
    run_here(survey, out)
    expected = rows_in(out / "map.db")
    damaged = next(out.glob(name))
    data = damaged.read_bytes()
    if empty:
        damaged.write_bytes(b"")
    elif name == "map.db":
        damaged.write_bytes(data[:-4096])
    else:
        damaged.write_bytes(data[: len(data) // 2] + bytes(len(data) - len(data) // 2))
    if not name.startswith("shards"):
        shutil.rmtree(out / "shards")
    else:
        (out / "map.json").unlink()
    if not empty and damaged.suffix in (".spool", ".db") and name != "map.db":
        with pytest.raises(SurveyError, match=re.escape(damaged.name)):
            run_here(survey, out)
    run_here(survey, out)
    assert rows_in(out / "map.db") == expected


def test_files_are_on_the_disk_before_their_marks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    monkeypatch.setattr(
        "os.fsync", lambda handle: synced.append(str(Path(f"/proc/self/fd/{handle}").readlink()))
    )
    Folder(str(tmp_path)).write("shards/a.db", b"1")
    assert [Path(path).name for path in synced] == ["file", "shards"]


def stopped(*_: object) -> None:
    raise KeyboardInterrupt


def test_two_at_once_in_one_folder_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = write_survey(tmp_path)
    code = "import sys, fcntl; f = open(sys.argv[1], 'w'); fcntl.flock(f, 2); print(1, flush=True); sys.stdin.read()"  # noqa: E501
    (tmp_path / "out").mkdir()
    words = [sys.executable, "-c", code, str(tmp_path / "out/.lock")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:  # noqa: S603 our own
        assert other.stdout is not None
        other.stdout.readline()
        words = ["run", str(survey), "--out", str(tmp_path / "out"), "--workers", "0"]
        assert main(words) == 2
        assert "another mapper-survey is at work" in capsys.readouterr().err
        other.communicate()


def test_the_folder_may_lie_elsewhere(tmp_path: Path) -> None:
    survey = write_survey(tmp_path, tile_size_m=12.8)
    run_here(survey, tmp_path / "out")
    elsewhere = Folder("memory://a-survey")
    request = read_survey(survey)
    for _ in range(2):
        run_survey(request, elsewhere, InProcess(), RunOptions(MEMORY), Silent())  # type: ignore[arg-type]
    (tmp_path / "fetched.db").write_bytes(elsewhere.read("map.db") or b"")
    assert rows_in(tmp_path / "fetched.db") == rows_in(tmp_path / "out/map.db")
    with pytest.raises(SurveyError, match="cannot be reached"):
        Folder("nothing-known://x")


def test_each_task_reports_what_it_took_and_what_it_waited_for(tmp_path: Path) -> None:
    record = run_here(write_survey(tmp_path, tile_size_m=12.8), tmp_path / "out")
    tasks = {task.name: task for task in record["tasks"]}
    plans, tiles, merges = (
        {name for name, task in tasks.items() if task.kind == kind}
        for kind in ("plan", "tile", "merge")
    )
    assert plans == {"plan/a", "plan/b"}
    assert len(tiles) > 1
    assert len(merges) == 1
    assert all(set(tasks[name].after) == plans for name in tiles)
    assert set(tasks[merges.pop()].after) == tiles
    assert all(task.cpu_s > 0 for task in tasks.values())
    assert all(min(task.read_bytes, task.written_bytes) > 0 for task in tasks.values())
