"""One table of exit codes for all commands."""

import importlib
import re
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mapper_survey
import pytest
import sonar_sim.command

import oculus_driver.cli
from mapperd.cli.mapperctl.command import main as mapperctl
from mapperd.cli.mapperd import main as mapperd
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import ExtraMissingError, missing_extra

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "cli.md"

COMMANDS: dict[str, Callable[[list[str]], int]] = {
    "mapperd": mapperd,
    "mapperctl": mapperctl,
    "oculus": oculus_driver.cli.main,
    "sonar-sim": sonar_sim.command.main,
    "mapper-survey": mapper_survey.main,
}

MISTAKES = [
    ("mapperd --replay none.mcap", ExitCode.NO_INPUT),
    ("mapperd --replay text", ExitCode.BAD_DATA),
    ("mapperd --config text", ExitCode.BAD_CONFIG),
    ("mapperd calibrate none.mcap", ExitCode.NO_INPUT),
    ("mapperd calibrate text", ExitCode.BAD_DATA),
    ("mapperd init /proc/none/vehicle.yaml --yes", ExitCode.CANNOT_WRITE),
    ("mapperctl convert none.map a.ply", ExitCode.NO_INPUT),
    ("mapperctl convert text a.ply", ExitCode.BAD_DATA),
    ("mapperctl convert text a.docx", ExitCode.CANNOT_WRITE),
    ("mapperctl diff none.map text", ExitCode.NO_INPUT),
    ("mapperctl bag none.mcap bag", ExitCode.NO_INPUT),
    ("mapperctl view none.map", ExitCode.NO_INPUT),
    ("mapperctl view text", ExitCode.BAD_DATA),
    ("mapperctl status --once --socket none", ExitCode.UNAVAILABLE),
    ("oculus info none.mcap", ExitCode.NO_INPUT),
    ("oculus info text", ExitCode.BAD_DATA),
    ("oculus log --out text", ExitCode.CANNOT_WRITE),
    ("sonar-sim explain none.yaml", ExitCode.NO_INPUT),
    ("sonar-sim explain text.yaml", ExitCode.BAD_CONFIG),
    ("sonar-sim capture tank --out none/tank.mcap", ExitCode.CANNOT_WRITE),
    ("mapper-survey plan none.yaml --out survey", ExitCode.NO_INPUT),
    ("mapper-survey plan text --out survey", ExitCode.BAD_CONFIG),
    *((f"{name} --no-such-option", ExitCode.USAGE) for name in COMMANDS),
]


def test_the_page_has_every_code() -> None:
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert {name: int(code) for code, name in rows} == {one.name: one.value for one in ExitCode}


def code_of(line: str) -> int:
    name, *words = line.split()
    try:
        return int(COMMANDS[name](words))
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize(("line", "code"), MISTAKES, ids=[line for line, _ in MISTAKES])
def test_a_mistake_has_the_code_of_its_kind(
    line: str,
    code: ExitCode,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/none")
    for name in ("text", "text.yaml"):
        Path(name).write_text("no recording, no map, no settings\n", "utf-8")
    assert code_of(line) == code
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("line", "module"),
    [
        ("mapperctl view", "viser"),
        ("oculus render text a.png", "oculus_driver.render"),
        ("sonar-sim list", "sonar_sim.command.capture"),
        ("mapper-survey plan text --out survey", "mapper_survey.command"),
    ],
)
def test_a_missing_extra_is_78(
    line: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    package, _, name = module.rpartition(".")
    if package:
        monkeypatch.delattr(sys.modules[package], name, raising=False)
    assert code_of(line) == ExitCode.BAD_CONFIG


@pytest.mark.parametrize(
    ("module", "draw"),
    [
        ("oculus_driver.cli.render", lambda module: module._painter(Namespace())),
        ("oculus_driver.cli.fire", lambda module: module._draw(Path("a.png"), None)),
    ],
)
def test_pictures_without_opencv_name_the_command_that_installs_it(
    module: str, draw: Callable[[Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "oculus_driver.render", None)
    with pytest.raises(ExtraMissingError) as missing:
        draw(importlib.import_module(module))
    assert missing_extra("OpenCV", "render") in str(missing.value)


def test_help_lists_the_commands_in_groups(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of("mapperd --help") == ExitCode.OK
    text = capsys.readouterr().out
    for words in ("set up:", "map live:", "map recordings:", "init", "doctor", "calibrate"):
        assert words in text
