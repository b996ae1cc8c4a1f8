"""`oculus log`, `watch` and `fire` against a played sonar on loopback."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import pytest

from oculus_driver import Faults
from oculus_driver.recording import SonarLog, open_recording
from tests.oculus_driver.cli.sonar_thread import played
from tests.support.process import free_port

if TYPE_CHECKING:
    from oculus_driver import PlaybackSonar
    from tests.oculus_driver.cli.conftest import Oculus

pytestmark = pytest.mark.net

NEAR = ("--range", "2", "--mode", "2")


def where(sonar: PlaybackSonar, status_port: int) -> tuple[Any, ...]:
    return ("--port", sonar.port, "--status-port", status_port, "--listen", "127.0.0.1")


def test_fire_takes_one_ping_with_the_settings_asked_for_and_leaves_standby(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "ping.png"
    with played(capture_path, speed=20.0, standby=True, resampled=True) as (sonar, status_port):
        words = (*NEAR, "--bits", "16", "--beams", "256", "--picture", picture, "--json")
        result = oculus("fire", *where(sonar, status_port), *words)
        demand = sonar.device.request
    (facts,) = result.facts
    assert result.code == 0
    assert (facts["rows"], facts["beams"], facts["bits_per_sample"]) == (704, 256, 16)
    assert (facts["confirmed"], facts["changed"]) == (True, [])
    assert cv2.imread(str(picture)) is not None
    assert demand is not None
    assert demand.standby


def test_fire_reports_what_the_sonar_did_otherwise(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path, speed=20.0, standby=True) as (sonar, status_port):  # as recorded
        words = ("--range", "7", "--patience", "1", "--json")
        result = oculus("fire", *where(sonar, status_port), *words)
    (facts,) = result.facts
    assert (result.code, facts["confirmed"]) == (1, False)
    changed = {one["name"]: (one["asked"], one["shown"]) for one in facts["changed"]}
    assert changed["mode"] == (1, 2)
    assert changed["range, m"] == (7.0, 2.0)


def test_a_shot_can_be_triggered(oculus: Oculus, capture_path: Path) -> None:  # quirk 9
    with played(capture_path, standby=True, resampled=True) as (sonar, status_port):
        result = oculus("fire", *where(sonar, status_port), *NEAR, "--trigger")
        pings = sonar.counters.pings
    assert (result.code, pings) == (0, 1)
    assert "settings confirmed" in result.out


def test_log_records_all_that_comes_and_starts_new_files(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    with played(capture_path, speed=50.0, standby=True) as (sonar, status_port):
        words = ("--out", tmp_path, "--duration", "1.5", "--file-mb", "1.1", "--free-mb", "0")
        result = oculus("log", *where(sonar, status_port), "--rate", "highest", "--json", *words)
        sent = sonar.counters.pings
    assert result.code == 0
    end = result.facts[-1]
    assert end["event"] == "end"
    files = sorted(tmp_path.iterdir())
    infos = [oculus("info", file, "--json").facts[0] for file in files]
    assert len(files) == end["files_opened"] > 2
    assert sum(info["pings"] for info in infos) == sent == end["sonar"]["pings"]
    assert all(info["bytes_rejected"] == 0 for info in infos)
    ids = [ping["id"] for info in infos for ping in info["ping_list"]]
    assert ids == [*range(415323, 415323 + sent)]


def test_the_report_at_the_end_counts_what_a_slow_disk_wrote_last(
    oculus: Oculus, capture_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = SonarLog.write

    def write_slowly(log: SonarLog, *args: Any, **options: Any) -> bool:
        time.sleep(0.01)
        return write(log, *args, **options)

    monkeypatch.setattr(SonarLog, "write", write_slowly)
    with played(capture_path, speed=50.0) as (sonar, status_port):
        words = ("--out", tmp_path, "--duration", "1", "--free-mb", "0", "--json")
        result = oculus("log", *where(sonar, status_port), *words)
    end = result.facts[-1]
    assert end["event"] == "end"
    (info,) = oculus("info", *tmp_path.iterdir(), "--json").facts
    recorded = sum(link["bytes"] for link in info["links"].values())
    assert end["bytes_written"] == recorded > 0


def test_a_log_goes_on_after_the_link_was_cut(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:  # quirk 22
    faults = Faults(restart=0.2, seed=4)
    with played(capture_path, speed=50.0, faults=faults) as (sonar, status_port):
        words = ("--out", tmp_path, "--duration", "3", "--free-mb", "0", "--json")
        result = oculus("log", *where(sonar, status_port), *words)
    states = [facts["state"] for facts in result.facts if facts["event"] == "state"]
    assert states.count("pinging") >= 2
    (info,) = oculus("info", *tmp_path.iterdir(), "--json").facts
    assert info["restarts"] >= 1
    with open_recording(next(tmp_path.iterdir())) as recording:
        assert any(chunk.gap_before for chunk in recording)  # two connections do not join
    assert info["pings"] > 0


def test_a_log_of_nothing_is_a_fault(oculus: Oculus, tmp_path: Path) -> None:
    words = ("--status-port", free_port(), "--listen", "127.0.0.1", "--duration", "0.1")
    result = oculus("log", "--out", tmp_path, *words)
    assert result.code == 1
    assert "nothing was recorded" in result.err


def test_a_log_without_space_is_reported_at_once_and_is_a_fault(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    with played(capture_path, speed=50.0) as (sonar, status_port):
        words = ("--out", tmp_path, "--duration", "1.5", "--free-mb", "1e12", "--json")
        result = oculus("log", *where(sonar, status_port), *words)
    first = result.facts[0]
    assert first["event"] == "recording"
    assert "--free-mb" in first["problem"]
    assert result.code == 1
    assert "nothing was recorded (less than" in result.err


def test_a_log_of_a_sonar_that_never_pings_is_reported_and_is_a_fault(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    silent = {"standby": True, "faults": Faults(silent_after_s=0.0)}
    with played(capture_path, **silent) as (sonar, status_port):
        words = ("--out", tmp_path, "--duration", "7", "--free-mb", "0", "--json")
        result = oculus("log", *where(sonar, status_port), *words)
    problems = [facts["problem"] for facts in result.facts if facts.get("event") == "recording"]
    assert problems == ["no ping for 5 s"]
    assert result.code == 1
    assert "no ping was recorded" in result.err


@pytest.mark.parametrize("given", [False, True])
def test_a_log_records_the_statuses_of_the_sonar(
    given: bool,  # noqa: FBT001 a parameter of the test
    oculus: Oculus,
    capture_path: Path,
    tmp_path: Path,
) -> None:
    with played(capture_path, speed=50.0) as (sonar, status_port):
        words = ["--out", tmp_path, "--duration", "1.5", "--free-mb", "0"]
        words += ["127.0.0.1"] if given else []
        assert oculus("log", *where(sonar, status_port), *words).code == 0
    (info,) = oculus("info", *tmp_path.iterdir(), "--json").facts
    assert info["links"]["status"]["encoding"] == "oculus-status"
    assert info["statuses"] > 3
    assert info["pings"] > 3


def test_watch_reports_statuses_without_connecting(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path) as (sonar, status_port):
        words = ("--duration", "0.5", "--json")
        result = oculus("watch", *where(sonar, status_port), *words)
        assert sonar.counters.clients == 0
    assert result.code == 0
    assert {facts["serial_number"] for facts in result.facts} == {7892}


def test_watch_reports_pings_on_request(oculus: Oculus, capture_path: Path) -> None:
    with played(capture_path, speed=20.0, resampled=True) as (sonar, status_port):
        words = ("--ping", "--duration", "1.5", "--every", "0.2", "--json", *NEAR)
        result = oculus("watch", *where(sonar, status_port), *words)
    pings = [facts for facts in result.facts if facts["event"] == "pings"]
    assert pings[-1]["rate_hz"] > 0
    assert (pings[-1]["rows"], pings[-1]["beams"]) == (704, 512)
    states = [facts["state"] for facts in result.facts if facts["event"] == "state"]
    assert "pinging" in states


@pytest.mark.parametrize("command", ["log", "fire", "watch"])
def test_settings_that_cannot_be_are_one_line(oculus: Oculus, command: str) -> None:
    words = ("--ping",) if command == "watch" else ()
    result = oculus(command, "127.0.0.1", "--range", "-5", *words)
    assert result.code == 2
    assert "range_m" in result.err
    assert result.err.count("\n") == 1


def test_watching_nothing_is_a_fault(oculus: Oculus) -> None:
    result = oculus("watch", "--duration", 0.3, "--status-port", free_port())
    assert (result.code, result.out) == (1, "")
    assert "no sonar" in result.err
    result = oculus("watch", "127.0.0.1", "--ping", "--port", 9, "--duration", 0.3)
    assert result.code == 1
    assert "no ping" in result.err


def test_a_log_goes_on_when_its_words_have_nowhere_to_go(
    capture_path: Path, tmp_path: Path
) -> None:
    with (
        played(capture_path, speed=None, loops=20) as (sonar, _),
        Path("/dev/full").open("w", encoding="ascii") as full,
    ):
        words = ["log", "127.0.0.1", "--port", str(sonar.port), "--range", "2", "--mode", "2"]
        words += ["--out", str(tmp_path), "--duration", "2"]
        command = [sys.executable, "-m", "oculus_driver.cli", *words]
        done = subprocess.run(  # noqa: S603 - our own words
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
    assert "continuing without it" in done.stderr
    assert "Traceback" not in done.stderr
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) > 100_000
    assert done.returncode == 0
