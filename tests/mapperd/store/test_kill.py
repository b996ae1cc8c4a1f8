"""The process dies at any instant; the map of the next one equals that of one that never died."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader
from tests.mapperd.store import dive

pytestmark = pytest.mark.crash

ROOT = Path(__file__).resolve().parents[3]
PINGS = 100
KILLS = int(os.environ.get("STORE_KILLS", "10"))


def start(path: Path, *more: str) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "tests.mapperd.store.dive", str(path), str(PINGS), *more]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)  # noqa: S603 our own


def begun_at(process: "subprocess.Popen[bytes]") -> int:
    """Where a process that has opened the store goes on."""
    assert process.stdout is not None
    return int(process.stdout.readline() or -1)


def wait_for_work(process: "subprocess.Popen[bytes]", seconds: float) -> None:
    """Wait until a process has computed for so long, whatever else the machine has to do."""
    until_s = computed_s(process) + seconds
    while process.poll() is None and computed_s(process) < until_s:
        time.sleep(0.002)


def computed_s(process: "subprocess.Popen[bytes]") -> float:
    words = Path(f"/proc/{process.pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def content(path: Path) -> tuple[bytes, int]:
    sonar_map = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        position = reader.load(sonar_map).position
    return sonar_map.core.encode_map(), int.from_bytes(position, "little")


def test_map_equals_that_of_a_process_that_was_never_killed(tmp_path: Path) -> None:
    reference = dive.mapped(PINGS).core.encode_map()
    chance = random.Random(7)  # noqa: S311 for the instants
    path = tmp_path / "dive.map"
    kills = mid_dive = 0
    while kills < KILLS:
        with start(path) as process:
            begin = begun_at(process) if chance.random() < 0.8 else 0
            wait_for_work(process, chance.uniform(0.0, 0.25))
            process.send_signal(signal.SIGKILL)
        assert begin >= 0
        if process.returncode == -signal.SIGKILL:
            kills += 1
            saved, pings = content(path) if path.exists() else (b"", 0)
            mid_dive += 0 < pings < PINGS
            assert not pings or saved == dive.mapped(pings).core.encode_map()
        else:  # the dive was done before it came to that
            assert content(path) == (reference, PINGS)
            for left in tmp_path.iterdir():
                left.unlink()
    with start(path) as process:
        assert begun_at(process) <= PINGS
    assert process.returncode == 0
    assert content(path) == (reference, PINGS)
    assert mid_dive > KILLS / 3


def test_no_moment_within_a_save_is_a_bad_one(tmp_path: Path) -> None:
    """Saves take milliseconds, which instants at random hardly meet; so each is met on purpose."""
    path = tmp_path / "dive.map"
    truth, at, kills = SonarMap(dive.CONFIG), 0, 0
    for statement in (1, 2, 3, 4, 5, 6, 7, 9, 12, 40, 41, 42, 100):
        with start(path, str(statement)) as process:
            begun_at(process)
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL
        kills += 1
        saved, pings = content(path)
        for number in range(at, pings):
            dive.integrate(truth, number)
        at = pings
        assert saved == truth.core.encode_map()
    assert kills >= 10
    assert at > 0
