"""What all commands have: a version, the nearest name, grouped help, shell completion."""

import argparse
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from mapper_survey.command import _parser as survey_parser
from sonar_sim.command import _parser as sim_parser

from mapperd.cli.arguments import _parser as mapperd_parser
from mapperd.cli.arguments import parse_arguments
from mapperd.cli.mapperctl.arguments import GROUPS
from mapperd.cli.mapperctl.arguments import parser as mapperctl_parser
from mapperd.cli.mapperd import main
from oculus_driver.cli import _parser as oculus_parser
from oculus_driver.command_line import CommandParser, ExitCode

PARSERS = {
    "mapperd": mapperd_parser,
    "mapperctl": mapperctl_parser,
    "oculus": oculus_parser,
    "sonar-sim": sim_parser,
    "mapper-survey": survey_parser,
}


def parsers() -> dict[str, CommandParser]:
    made = {name: make() for name, make in PARSERS.items()}
    assert all(isinstance(one, CommandParser) for one in made.values())
    return {name: one for name, one in made.items() if isinstance(one, CommandParser)}


def command_lines() -> list[str]:
    """Return all commands and their subcommands; some of `oculus` have another --version."""
    found = []
    for name, parser in parsers().items():
        found.append(name)
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                found += [f"{name} {one}" for one in action.choices]
    of_fire_messages = ("oculus log", "oculus watch", "oculus fire", "oculus doctor")
    return [one for one in found if one not in of_fire_messages]


@pytest.mark.parametrize("line", command_lines())
def test_every_command_has_a_version(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, *words = line.split()
    with pytest.raises(SystemExit) as ended:
        parsers()[name].parse_args([*words, "--version"])
    assert ended.value.code == 0
    assert re.fullmatch(rf"{name} \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("name", "words", "hint"),
    [
        ("mapperctl", ["statsu"], "did you mean status?"),
        ("mapperctl", ["status", "--jsn"], "did you mean --json?"),
        ("mapperctl", ["get", "filtering.min_rnge"], "did you mean filtering.min_range?"),
        ("mapperctl", ["get", "filteringg"], "did you mean filtering?"),
        ("mapperctl", ["sonar", "sett"], "did you mean set?"),
        ("mapperctl", ["sonar", "xyzzy"], "allowed: set, standby, live"),
        ("mapperctl", ["xyzzy"], "allowed: status, "),
        ("oculus", ["discver"], "did you mean discover?"),
        ("sonar-sim", ["serv"], "did you mean serve?"),
        ("mapper-survey", ["rn"], "did you mean run?"),
        (
            "sonar-sim",
            ["capture", "tank", "--out", "x", "--duration", "3"],
            "; it is an option of sonar-sim serve (",
        ),
        (
            "mapperctl",
            ["reset", "--print-completion=bash"],
            "; it belongs before the command: mapperctl ",
        ),
    ],
)
def test_a_typing_error_names_the_nearest(
    name: str, words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parsers()[name].parse_args(words)
    error = capsys.readouterr().err
    assert (ended.value.code, error.count("\n")) == (2, 1)
    assert hint in error


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["dive one.mcap"], "mapperd --replay 'dive one.mcap'"),
        (["harbour.yaml"], "mapperd --config harbour.yaml"),
        (["a/map.bt"], "mapperctl view a/map.bt"),
        (["docter"], "did you mean doctor?"),
        (["calibrat"], "did you mean calibrate?"),
        (["--replya", "a"], "did you mean --replay?"),
    ],
)
def test_mapperd_names_what_was_meant(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parse_arguments(words)
    error = capsys.readouterr().err
    assert (ended.value.code, error.count("\n")) == (2, 1)
    assert hint in error


def test_help_lists_every_command_in_a_group_with_examples() -> None:
    parser = mapperctl_parser()
    (commands,) = (one for one in parser._actions if one.choices and one.dest == "command")
    assert sorted(sum(GROUPS.values(), ())) == sorted(commands.choices or ())
    text = parser.format_help()
    for title, names in GROUPS.items():
        _, _, below = text.partition(f"\n {title}:\n")
        for name in names:
            assert re.search(rf"^ +{name}\b", below, re.MULTILINE), name
    assert "examples:" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("name", PARSERS)
def test_bash_accepts_the_completion(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit) as ended:
        parsers()[name].parse_args(["--print-completion", "bash"])
    assert ended.value.code == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    assert f" {name}\n" in script.read_text(encoding="utf-8")
    bash = shutil.which("bash") or "bash"
    subprocess.run([bash, "-n", str(script)], check=True)  # noqa: S603 our own script


def test_bash_completes_the_commands_of_mapperd(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit):
        main(["--print-completion", "bash"])
    script = capsys.readouterr().out
    for words, expected in (("", ["init", "doctor", "calibrate"]), ("init --veh", ["--vehicle"])):
        *before, last = ["mapperd", *words.split(" ")]
        line = f"COMP_WORDS=({' '.join(before)} '{last}'); COMP_CWORD={len(before)}"
        call = f"{line}; _shtab_mapperd mapperd '{last}'; echo ${{COMPREPLY[@]}}"
        bash = [shutil.which("bash") or "bash", "-c", f"{script}\n{call}"]
        done = subprocess.run(bash, capture_output=True, text=True, check=True)  # noqa: S603 our own
        assert sorted(done.stdout.split()) == sorted(expected)


@pytest.mark.parametrize("command", ["calibrate", "doctor", "init"])
def test_commands_of_mapperd_have_a_version_and_errors_of_one_line(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("mapperd ")
    with pytest.raises(SystemExit) as ended:
        main([command, "--confg", "a.yaml", "b", "c"])
    error = capsys.readouterr().err
    assert (ended.value.code, error.count("\n")) == (2, 1)
    assert f"mapperd {command} --help" in error


def test_without_shtab_one_line_installs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "shtab", None)
    with pytest.raises(SystemExit) as ended:
        mapperctl_parser().parse_args(["--print-completion", "zsh"])
    error = capsys.readouterr().err
    assert (ended.value.code, error.count("\n")) == (ExitCode.BAD_CONFIG, 1)
    assert "-m pip install shtab" in error
