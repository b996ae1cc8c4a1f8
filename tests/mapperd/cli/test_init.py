"""`mapperd init`: settings and a token from options or answers."""

import os
import pty
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mapperd.cli.init import DVLS, VEHICLES, init
from mapperd.config.layers import load_files, load_settings
from mapperd.config.loader import config_from_text, load_config
from mapperd.config.paths import map_path, recordings_folder
from mapperd.wire.auth import read_token

ROOT = Path(__file__).resolve().parents[3]


def test_the_settings_of_a_bluerov2_need_no_further_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert init(["--yes"]) == 0
    folder = tmp_path / "mapperd"
    config = load_settings([], os.environ).config
    assert config == load_config(folder / "mapperd.yaml")
    assert config.server.address == "0.0.0.0:7471"
    assert config.server.token_file == str(folder / "token")
    assert len(read_token(folder / "token")) == 64
    assert stat.S_IMODE((folder / "token").stat().st_mode) == 0o600
    assert [one.name for one in config.odometry.sources] == ["autopilot", "dvl"]
    printed = capsys.readouterr().out
    for words in ("\n  mapperd doctor\n  mapperd\n", "view --open", "UDP client", ":7471 --token"):
        assert words in printed


def test_the_example_is_what_init_writes(tmp_path: Path) -> None:
    path = tmp_path / "bluerov2.yaml"
    assert init([str(path), "--yes", "--stream", "127.0.0.1:7471"]) == 0
    assert path.read_text() == (ROOT / "config" / "bluerov2.yaml").read_text()
    assert not (tmp_path / "token").exists()


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("dvl", DVLS)
@pytest.mark.parametrize("more", [(), ("--fixed",), ("--water", "fresh", "--stream", "none")])
def test_every_vehicle_has_valid_settings(
    vehicle: str, dvl: str, more: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "vehicle.yaml"
    assert init([str(path), "--yes", "--vehicle", vehicle, "--dvl", dvl, *more]) == 0
    config = load_config(path)
    assert config.odometry.owners.position == ("fixed" if "--fixed" in more else "")
    assert config.water.salinity == (0.0 if "fresh" in more else 35.0)


SET_UPS = [
    [],
    ["--dvl", "none"],
    ["--dvl", "autopilot", "--fixed", "--water", "fresh"],
    ["--vehicle", "native", "--sonar", "127.0.0.1", "--stream", "none"],
    ["--vehicle", "nmea", "--stream", "127.0.0.1:7471", "--folder", "harbour"],
]


@pytest.mark.parametrize("user", SET_UPS, ids=" ".join)
@pytest.mark.parametrize("given", SET_UPS, ids=" ".join)
def test_a_file_on_top_of_the_users_file_is_its_own_set_up(
    user: list[str], given: list[str], tmp_path: Path
) -> None:
    below, above = tmp_path / "user" / "mapperd.yaml", tmp_path / "given" / "harbour.yaml"
    assert init([str(below), "--yes", *user]) == 0
    assert init([str(above), "--yes", *given]) == 0
    assert load_files([below, above]).config == load_config(above)


def test_options_are_written(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    words = "--sonar 192.168.2.3 --position -1,0.5,-2 --orientation 180,90,-5 --range 25"
    joined = words.replace("--position ", "--position=")
    assert init([str(path), "--yes", *joined.split()]) == 0
    config = load_config(path)
    assert (config.device.address, config.device.range) == ("192.168.2.3", 25.0)
    place, turn = config.mounting.position, config.mounting.orientation
    assert (place.x, place.y, place.z) == (-1.0, 0.5, -2.0)
    assert (turn.roll, turn.pitch, turn.yaw) == (180.0, 90.0, -5.0)


def test_a_folder_holds_map_and_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert init(["vehicle.yaml", "--yes", "--folder", 'a "b" \u00e4']) == 0
    config = load_config(Path("vehicle.yaml"))
    folder = tmp_path / 'a "b" \u00e4'
    assert map_path(config, {}) == folder / "mapperd.map"
    assert recordings_folder(config, {}) == folder / "recordings"


def test_no_file_is_replaced_unasked_and_a_token_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "vehicle.yaml"
    assert init([str(path), "--yes"]) == 0
    token = (tmp_path / "token").read_text()
    assert init([str(path), "--yes", "--range", "5"]) == 73
    assert capsys.readouterr().err == f"mapperd init: {path}: exists; --force replaces it\n"
    assert init([str(path), "--yes", "--range", "5", "--force"]) == 0
    assert load_config(path).device.range == 5.0
    assert (tmp_path / "token").read_text() == token


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--range", "999"], 2, "device.range: 999.0 is not allowed; allowed: "),
        (["--range", "far"], 2, "argument --range: 'far': a number was expected"),
        (["--position", "1,2"], 2, "'1,2': three numbers were expected"),
        (["--sonar", "sonar.local"], 2, "device.address"),
        (["--stream", "lan"], 2, "expected 127.0.0.1:7471"),
        (["--service"], 2, "FILE or --service, not both"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(
    words: list[str],
    code: int,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    try:
        got = init([str(tmp_path / "vehicle.yaml"), "--yes", *words])
    except SystemExit as error:
        got = int(str(error.code))
    assert got == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mapperd init: ")
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert init(["/proc/none/vehicle.yaml", "--yes"]) == 73
    assert capsys.readouterr().err.startswith("mapperd init: /proc/none: cannot be written: ")


def dialogue(tmp_path: Path, answers: str) -> tuple[int, str]:
    """Answer on a terminal; return exit code and output."""
    ours, theirs = pty.openpty()
    os.write(ours, answers.encode())
    words = ["init", str(tmp_path / "vehicle.yaml"), "--sonar", "any"]
    done = subprocess.run(  # noqa: S603 our own command
        [sys.executable, "-m", "mapperd", *words],
        stdin=theirs,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    os.close(ours)
    os.close(theirs)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_on_a_terminal_it_asks_until_the_answer_is_valid(tmp_path: Path) -> None:
    answers = ["boat", "bluerov2", "none", "yes", "", "0,90,0", "9999", "20", "fresh", "none", ""]
    code, output = dialogue(tmp_path, "\n".join(answers))
    assert code == 0, output
    assert "'boat': one of bluerov2, native, nmea was expected" in output
    assert "device.range: 9999.0 is not allowed" in output
    config = config_from_text((tmp_path / "vehicle.yaml").read_text())
    assert config.odometry.owners.position == "fixed"
    assert config.mounting.orientation.pitch == 90.0
    assert config.device.range == 20.0
    assert config.odometry.sources[0].water_density == 998.0
    assert config.server.address == ""


@pytest.mark.slow
def test_the_end_of_the_answers_writes_nothing(tmp_path: Path) -> None:
    code, output = dialogue(tmp_path, "bluerov2\n\x04")
    assert code == 130
    assert "nothing was written" in output
    assert list(tmp_path.iterdir()) == []
