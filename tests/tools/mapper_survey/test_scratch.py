"""SQLite writes on a disk of the machine, wherever the survey's folder lies."""

import errno
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from mapper_survey.folder import PREFIX, YOUNG_S, Folder, scratch

from tests.tools.mapper_survey.dives import rows_in, run_here, write_survey

ROOT = Path(__file__).resolve().parents[3]

KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from mapper_survey.folder import scratch
with scratch() as work:
    (work / "shard.db").write_bytes(b"1")
    print(work, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this machine's own folders are for one test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def test_sqlite_neither_writes_nor_locks_in_the_surveys_folder(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    connect: Any = sqlite3.connect

    def noted(name: Any, *args: Any, **more: Any) -> Any:
        opened.append(unquote(str(name)))
        return connect(name, *args, **more)

    monkeypatch.setattr(sqlite3, "connect", noted)
    out = tmp_path / "out"
    run_here(write_survey(tmp_path, tile_size_m=12.8), out)
    there = [name for name in opened if str(out) in name]
    here = [name for name in opened if str(temporary) in name]
    shards = list(out.glob("shards/*.db"))
    assert len(shards) > 1
    assert len(here) == len(shards) + 1
    assert len(there) == len(shards)
    assert all(name.endswith("?mode=ro&immutable=1") for name in there)
    assert list(temporary.iterdir()) == []


def test_a_survey_may_lie_on_another_disk(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = os.rename

    def within_one_disk(source: Any, to: Any) -> None:
        if str(temporary) in str(source):
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, to)

    survey = write_survey(tmp_path, tile_size_m=12.8)
    run_here(survey, tmp_path / "near")
    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", within_one_disk)
        run_here(survey, tmp_path / "far")
    assert rows_in(tmp_path / "far/map.db") == rows_in(tmp_path / "near/map.db")
    assert list((tmp_path / "far/.work").iterdir()) == []


def test_a_file_has_its_name_only_when_it_is_whole(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A copy from another disk may stop half way."""
    finished = temporary / "shard.db"
    finished.write_bytes(b"12345678")

    def refused(*_: object) -> None:
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    def half(_: Any, to: Any) -> None:
        Path(to).write_bytes(b"1234")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "rename", refused)
    monkeypatch.setattr(shutil, "copyfile", half)
    with pytest.raises(OSError, match="No space left"):
        Folder(str(tmp_path / "out")).put(finished, "shards/a.db")
    assert [path.name for path in (tmp_path / "out").rglob("*.db")] == []


def test_what_the_killed_have_left_is_removed(temporary: Path) -> None:
    words = [sys.executable, "-c", KILLED, str(ROOT / "tools")]
    reported = subprocess.run(words, cwd=ROOT, check=False, stdout=subprocess.PIPE, text=True)  # noqa: S603 our own
    left = Path(reported.stdout.strip())
    assert (left / "shard.db").exists()
    long_ago_s = time.time() - 2 * YOUNG_S
    with scratch() as mine:
        assert left.exists()  # it might be about to be locked
        for path in (left, mine):
            os.utime(path, (long_ago_s, long_ago_s))
        (temporary / "others").mkdir()
        with scratch() as second:
            assert not left.exists()
            assert {path.name for path in temporary.iterdir()} == {mine.name, second.name, "others"}


def test_only_folders_of_this_machine_that_nobody_else_makes_are_removed(temporary: Path) -> None:
    """A survey may lie there itself, and other machines may share the folder."""
    with scratch() as mine:
        others = mine.with_name(f"{PREFIX}0123456789abcdef.xyz")
    names = [others.name, "mapper-survey-north", PREFIX, f"{PREFIX}north"]
    long_ago_s = time.time() - 2 * YOUNG_S
    for name in names:
        (temporary / name).mkdir()
        (temporary / name / "map.db").write_bytes(b"1")
        os.utime(temporary / name, (long_ago_s, long_ago_s))
    with scratch():
        assert all((temporary / name / "map.db").exists() for name in names)
