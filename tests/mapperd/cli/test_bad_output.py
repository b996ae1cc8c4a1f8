"""Wherever the results cannot go: one clear line, and every other result is there."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from oculus_driver.command_line import ExitCode

Write = Callable[..., list[int]]
Survey = Callable[..., list[Any]]
PingBytes = Callable[..., bytes]
OdometryBytes = Callable[..., bytes]

Run = Callable[..., Any]

STILL = "--pose=0,0,0,0,0,0"


@pytest.mark.parametrize(
    "name", ["map.png", "map.ply", "map.bt", "summary.json", ".map.bt.partial"]
)
def test_result_that_cannot_be_written_costs_only_itself(
    tmp_path: Path, run: Run, ping_bytes: PingBytes, name: str
) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    (tmp_path / "out" / name / "inside").mkdir(parents=True)
    ran = run(tmp_path / "raw", STILL)
    assert ran.code == ExitCode.CANNOT_WRITE
    assert ran.output.count("\n") == 1
    lost = name.removeprefix(".").removesuffix(".partial")
    assert lost in ran.output
    written = {path.name for path in ran.out.iterdir() if path.is_file()}
    assert written == {"map.bt", "map.ply", "map.png", "summary.json"} - {lost}


def test_picture_in_the_way_that_cannot_be_removed_is_named(
    tmp_path: Path,
    run: Run,
    ping_bytes: PingBytes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mapperd.daemon.map_folder.can_draw", lambda: False)
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    (tmp_path / "out" / "map.png").mkdir(parents=True)
    ran = run(tmp_path / "raw", STILL)
    assert ran.code == ExitCode.CANNOT_WRITE
    assert "map.png: cannot be removed" in ran.output
    assert (ran.out / "map.bt").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirection", "code", "output"),
    [
        (">&-", ExitCode.OK, ""),
        ("2>&-", ExitCode.OK, ""),
        (">&- 2>&-", ExitCode.OK, ""),
        ("2>/dev/full", ExitCode.OK, ""),
        (
            ">/dev/full",
            ExitCode.CANNOT_WRITE,
            "mapperd: standard output: cannot be written: No space left on device\n",
        ),
    ],
)
def test_standard_streams_that_take_nothing(
    tmp_path: Path,
    ping_bytes: PingBytes,
    redirection: str,
    code: int,
    output: str,
) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    words = f"--replay {tmp_path}/raw --out {tmp_path}/out {STILL}"
    done = subprocess.run(  # noqa: S602 our own program
        f"{sys.executable} -m mapperd {words} {redirection}",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stderr == output
    assert done.returncode == code
    assert (tmp_path / "out" / "summary.json").exists()


@pytest.mark.slow
def test_the_real_program_has_no_traceback_either(tmp_path: Path) -> None:
    (tmp_path / "zeros").write_bytes(bytes(1000))
    for words in (
        ["--replay", str(tmp_path / "zeros")],
        ["--replay", str(tmp_path)],
        ["--replay", str(tmp_path / "zeros"), "--pose", "a"],
        ["--start", "1"],
    ):
        done = subprocess.run(  # noqa: S603 our own program
            [sys.executable, "-m", "mapperd", *words],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert done.returncode in (2, 65, 66)
        assert done.stderr.count("\n") == 1
        assert done.stderr.startswith("mapperd: ")
