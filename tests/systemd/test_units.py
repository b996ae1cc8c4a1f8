"""Units and rules, checked by systemd's own tools where they are."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from oculus_driver.command_line import ExitCode

FOLDER = Path(__file__).resolve().parents[2] / "systemd"
UNITS = sorted(path for path in FOLDER.iterdir() if path.suffix in (".service", ".socket"))
SERVICES = [path for path in UNITS if path.suffix == ".service"]
MAX_EXPOSURE = 2.0

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
)


def settings(path: Path) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in path.read_text().splitlines():
        name, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


def analyze(*words: str) -> str:
    done = subprocess.run(  # noqa: S603 our own words
        ["systemd-analyze", *words],  # noqa: S607 wherever it is
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_verify_is_silent(unit: Path, tmp_path: Path) -> None:
    # The program need not be installed where the tests run; all else is as shipped. A misspelt
    # key is a line of output and no failure: there must be no line.
    for each in UNITS:
        text = each.read_text().replace("/opt/mapperd/bin/", f"{tmp_path}/")
        (tmp_path / each.name).write_text(text)
    for name in ("mapperd", "oculus"):
        shutil.copy("/bin/true", tmp_path / name)
    assert analyze("verify", "--man=no", str(tmp_path / unit.name)) == ""


@needs_systemd
@pytest.mark.parametrize("unit", SERVICES, ids=lambda path: path.name)
def test_exposure_is_low(unit: Path) -> None:
    report = analyze("security", "--offline=true", str(unit))
    score = re.search(r"exposure level for \S+: ([0-9.]+)", report)
    assert score is not None, report
    assert float(score[1]) <= MAX_EXPOSURE


def test_the_daemon_is_supervised_by_its_messages() -> None:
    unit = settings(FOLDER / "mapperd.service")
    assert unit["Type"] == ["notify"]
    assert unit["NotifyAccess"] == ["main"]
    assert float(unit["WatchdogSec"][0]) > 0
    assert unit["Restart"] == ["on-failure"]
    assert unit["RestartPreventExitStatus"] == [str(int(ExitCode.BAD_CONFIG))]
    for name in ("StateDirectory", "LogsDirectory", "RuntimeDirectory", "ConfigurationDirectory"):
        assert unit[name] == ["mapperd"]
    wanted = {"mqtt-password", "server-token", "control-token", "stream-token"}
    assert {value.partition(":")[0] for value in unit["LoadCredential"]} == wanted


def test_udev_rules_have_only_known_keys() -> None:
    text = (FOLDER / "70-mapperd.rules").read_text()
    rules = [line for line in text.splitlines() if line and not line.startswith("#")]
    key = r'(ACTION|SUBSYSTEM|ENV\{\w+\})(==|!=)"[^"]*"'
    act = r'(SYMLINK\+=|GROUP=|MODE=|TAG\+=|GOTO=|LABEL=)"[^"]+"'
    for rule in rules:
        assert re.fullmatch(rf"({key}|{act})(, ({key}|{act}))*", rule), rule
    labels = set(re.findall(r'LABEL="(\w+)"', text))
    assert set(re.findall(r'GOTO="(\w+)"', text)) == labels


@pytest.mark.skipif(
    shutil.which("systemd-sysusers") is None, reason="systemd-sysusers is not installed"
)
def test_sysusers_are_understood() -> None:
    done = subprocess.run(  # noqa: S603 our own words
        ["systemd-sysusers", "--dry-run", str(FOLDER / "mapperd.sysusers")],  # noqa: S607
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "mapperd" in done.stdout + done.stderr


def test_names_in_the_documents_are_those_of_the_files() -> None:
    page = (FOLDER.parent / "docs" / "getting-started" / "service.md").read_text()
    for path in FOLDER.iterdir():
        assert path.name in page, path.name
