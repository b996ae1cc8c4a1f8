"""`mapperctl sonar` against a running daemon, with the simulator as the sonar."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperd import main as mapperd_main
from mapperd.pipeline.decoder import PingStream
from oculus_driver import Ping
from oculus_driver.command_line import ExitCode
from oculus_driver.recording import open_recording
from oculus_driver.sound_speed import speed_of_sound_mps
from tests.support.process import free_port, free_tcp_port

pytestmark = pytest.mark.net

PATIENCE_S = 60.0
PROGRAMS = Path(sys.executable).parent


def numbers_of(line: str) -> list[float]:
    """Numbers of a line, in its order; those inside of names do not count."""
    return [float(text) for text in re.findall(r"\b\d+(?:\.\d+)?\b", line)]


@contextmanager
def running(*words: object) -> Iterator["subprocess.Popen[str]"]:
    """Run a program until the end of the block, then interrupt it."""
    process = subprocess.Popen(  # noqa: S603 our own programs
        [str(PROGRAMS / str(words[0])), *map(str, words[1:])],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)


def answer_of(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = main([str(word) for word in words])
    shown = capsys.readouterr()
    return code, shown.out, shown.err


class Surveyed:
    """A daemon that maps the simulator's tank, until `stop`."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.socket = folder, folder / "m.sock"
        self.config = folder / "s.yaml"
        self.sonar_port, self.vehicle_port = free_tcp_port(), free_port()
        self.config.write_text(
            "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 20}}\n"
            "device: {address: 127.0.0.1, range: 12.0, beams: 256, "
            f"port: {self.sonar_port}}}\n"
            f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{self.vehicle_port}'}}]}}\n"
            f"recording: {{folder: '{folder / 'rec'}', free_floor: 0}}\n"
            f"service: {{state_folder: '{folder / 'state'}'}}\n"
            f"server: {{socket: '{self.socket}'}}\n",
            encoding="utf-8",
        )

    @contextmanager
    def running(self) -> Iterator[None]:
        simulator = (
            *("sonar-sim", "serve", "flat_floor", "--standby", "--port", self.sonar_port),
            *("--status-to", "127.0.0.1", "--status-port", free_port()),
            *("--odometry", f"native@udp:127.0.0.1:{self.vehicle_port}"),
        )
        daemon = ("mapperd", "--config", self.config, "--out", self.folder / "live")
        with running(*simulator), running(*daemon):
            assert self.mapped("range_m", 12.0, 0.5)
            yield

    def status(self) -> dict[str, Any]:
        words = [str(PROGRAMS / "mapperctl"), "status", "--once", "--json", "--socket"]
        found = subprocess.run(  # noqa: S603 our own program
            [*words, str(self.socket)], capture_output=True, text=True, check=False
        )
        status: dict[str, Any] = json.loads(found.stdout) if found.returncode == 0 else {}
        return status

    def mapped(self, key: str, value: float, tolerance: float) -> bool:
        """Wait until a mapped ping has about this value."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            sonar = self.status().get("sonar", {})
            if abs(sonar.get(key, 0.0) - value) < tolerance:
                return True
            time.sleep(0.2)
        return False

    def ranges_m(self) -> list[float]:
        """Ranges of all recorded pings."""
        ranges: list[float] = []
        for path in sorted((self.folder / "rec").glob("*.mcap")):
            stream = PingStream(confirm=True)
            with open_recording(path) as recording:
                for chunk in recording:
                    if chunk.encoding == "oculus":
                        arrivals = stream.feed(chunk.link, chunk.data, chunk.arrival_ns)
                        pings = [one.ping for one in arrivals]
                        ranges += [one.max_range_m for one in pings if isinstance(one, Ping)]
        return ranges


@pytest.mark.slow
def test_the_sonar_is_controlled_while_it_maps_and_the_recording_repeats_it(
    short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = Surveyed(short)
    here = ("--socket", survey.socket)
    with survey.running():
        code, out, _ = answer_of(capsys, "sonar", "set", "--range", 8, *here)
        assert code == ExitCode.OK
        change, confirmed = out.splitlines()
        assert change.startswith("device.range: ")
        assert numbers_of(change) == [12.0, 8.0]
        assert "in force" in confirmed
        assert survey.mapped("range_m", 8.0, 0.5)

        code, _, err = answer_of(capsys, "sonar", "set", "--range", 100, "--mode", 2, *here)
        assert code == ExitCode.FAULT
        assert err.startswith("mapperctl: device.range: ")
        assert {100.0, 40.0, 2.0} <= set(numbers_of(err)), "what was asked, and what is allowed"
        assert survey.mapped("range_m", 8.0, 0.5), "a refusal changes nothing"

        changes = ("--gain", 70, "--gamma", 127, "--bits", 16, "--gain-assist", "true")
        water = ("--salinity", 0, "--temperature", 12)
        code, out, _ = answer_of(capsys, "sonar", "set", *changes, *water, *here)
        assert code == ExitCode.OK
        code, out, _ = answer_of(capsys, "sonar", *here)
        shown = dict(line.split(maxsplit=1) for line in out.splitlines()[1:])
        assert shown["device.gain"] == "70.0 %"
        assert numbers_of(shown["device.range"])[:2] == [8.0, 120.0], "set, and allowed"
        assert shown["water.temperature"].startswith("12.0 °C")
        requested = survey.status()["sonar"]["requested"]
        assert (requested["bits_per_sample"], requested["gamma"]) == (16, 127)
        assert requested["gain_assist"] is True
        assert abs(requested["speed_of_sound_mps"] - speed_of_sound_mps(12, 0)) < 1e-9
        assert survey.mapped("speed_of_sound_mps", speed_of_sound_mps(12, 0), 0.1)

        assert answer_of(capsys, "sonar", "standby", *here)[0] == ExitCode.OK
        assert survey.status()["sonar"]["state"] == "standby"
        assert answer_of(capsys, "sonar", "live", *here)[0] == ExitCode.OK
        assert survey.status()["sonar"]["state"] == "pinging"

        _, out, _ = answer_of(capsys, "events", *here)
        assert "setting device.range is now 8.0" in out
    ranges_m = survey.ranges_m()
    changed = next(k for k, range_m in enumerate(ranges_m) if range_m < 9.0)
    assert changed > 0, ranges_m
    assert all(abs(range_m - 12.0) < 0.5 for range_m in ranges_m[:changed])
    assert all(abs(range_m - 8.0) < 0.5 for range_m in ranges_m[changed:])

    again = ["--replay", str(short / "rec"), "--as-recorded", "--out", str(short / "again")]
    assert mapperd_main(again) == ExitCode.OK
    capsys.readouterr()
    live, replayed = (
        json.loads((short / name / "summary.json").read_text(encoding="utf-8"))
        for name in ("live", "again")
    )
    assert live["pings_mapped"] == replayed["pings_mapped"] > 10
    assert live["map_sha256"] == replayed["map_sha256"]
    assert replayed["config"]["device"]["range"] == 8.0


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (("sonar", "set"), "sonar set needs an option: --range, "),
        (("sonar", "--range", "8"), "options change settings: mapperctl sonar set ..."),
        (("sonar", "standby", "--gain", "8"), "options change settings: mapperctl sonar set ..."),
    ],
)
def test_a_command_that_means_nothing_is_one_line(
    words: tuple[str, ...], remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = answer_of(capsys, *words, "--address", "127.0.0.1:1")
    assert code == ExitCode.USAGE
    assert err.startswith(f"mapperctl: {remedy}")
    assert err.count("\n") == 1
