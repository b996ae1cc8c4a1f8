"""The commands of localization, and what a person sees of it."""

import json
import math
import signal
from collections.abc import Callable
from typing import Any

import pytest

from mapperd.api import PoseRequest
from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperctl.views import localization_lines, status_lines
from mapperd.config.loader import config_of
from mapperd.localization.report import localization_report, localization_summary
from tests.mapperd.cli.mapperctl.conftest import Running
from tests.mapperd.cli.mapperctl.test_commands import Terminal
from tests.mapperd.localization.believed import snapshot
from tests.support.control_server import refusal

pytestmark = pytest.mark.net

Call = Callable[..., tuple[int, list[str], str]]
CONFIG = config_of({"localization": {"mode": "global"}}, "")


@pytest.fixture
def call(running: Running, capsys: pytest.CaptureFixture[str]) -> Call:
    def run(*words: str) -> tuple[int, list[str], str]:
        code = main([*words, "--socket", str(running.socket)])
        output = capsys.readouterr()
        return int(code), output.out.splitlines(), output.err

    return run


def test_commands_are_done(call: Call, running: Running) -> None:
    for words in (
        ["initial_pose", "1.5", "-2", "-90"],
        ["global_localization"],
        ["request_nomotion_update"],
    ):
        code, lines, error = call(*words)
        assert (code, len(lines), error) == (0, 1, "")
    for words in (["set_map", "tank.yaml", "1.5", "-2", "-90"], ["set_map", "tank.yaml"]):
        code, (line,), _ = call(*words)
        assert (code, line.split()[-1]) == (0, "/maps/tank.yaml")
    daemon = running.one.daemon
    assert [what[0] for what in daemon.done] == [
        "initial_pose", "global_localization", "request_nomotion_update", "set_map", "set_map",
    ]  # fmt: skip
    assert daemon.poses == [PoseRequest(1.5, -2.0, -math.pi / 2)] * 2 + [None]


def test_how_sure_a_pose_is_can_be_reported(call: Call, running: Running) -> None:
    call("initial_pose", "0", "0", "0", "--std-xy", "0.1", "--std-yaw-deg", "180")
    call("initial_pose", "0", "0", "0", "--covariance", "1,-0.5,0,2,0.1,3", "--frame", "tank")
    first, second = running.one.daemon.poses
    assert first == PoseRequest(0.0, 0.0, 0.0, 0.1, math.pi)
    rows = ((1.0, -0.5, 0.0), (-0.5, 2.0, 0.1), (0.0, 0.1, 3.0))
    assert second == PoseRequest(0.0, 0.0, 0.0, covariance=rows, frame="tank")


@pytest.mark.parametrize(
    ("reason", "code"),
    [("no_map", 1), ("no_filter", 1), ("wrong_frame", 1), ("bad_pose", 2), ("no_such_map", 2),
     ("bad_name", 2), ("busy", 75)],
)  # fmt: skip
def test_refusal_is_one_line_and_a_code(
    call: Call, running: Running, reason: str, code: int
) -> None:
    running.one.daemon.fault = refusal(reason)
    assert call("global_localization")[::2] == (code, f"mapperctl: it cannot be: {reason}\n")


@pytest.mark.parametrize(
    "words",
    [
        ["initial_pose"],
        ["initial_pose", "1", "2"],
        ["initial_pose", "nan", "2", "3"],
        ["initial_pose", "1", "inf", "3"],
        ["initial_pose", "1e7", "2", "3"],
        ["initial_pose", "1", "2", "north"],
        ["initial_pose", "1", "2", "3", "--std-xy", "-1"],
        ["initial_pose", "1", "2", "3", "--covariance", "1,2,3"],
        ["initial_pose", "1", "2", "3", "--covariance", "1,0,0,nan,0,1"],
        ["localization", "--particles", "501"],
        ["set_map"],
        ["global_localization", "1"],
    ],
)
def test_command_that_makes_no_sense_exits_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("words", [["a.map", "1"], ["a.map", "1", "2"], ["a.map", "--std-xy", "1"]])
def test_part_of_a_pose_is_invalid(call: Call, running: Running, words: list[str]) -> None:
    code, _, output = call("set_map", *words)
    assert code == 2
    assert output.startswith("mapperctl: ")
    assert "X Y YAW_DEG" in output
    assert running.one.daemon.done == []


def test_look_at_it(call: Call) -> None:
    assert call("localization")[1] == ["localization is off: localization.mode"]
    (line,) = call("localization", "--json", "--particles", "9")[1]
    assert json.loads(line)["particles"] == 9


def test_watch_goes_on_until_interrupted(running: Running) -> None:
    person = Terminal("localization", "--watch", "--socket", str(running.socket))
    person.see(b"\x1b[H\x1b[Jlocalization is off", times=2)
    person.process.send_signal(signal.SIGINT)
    assert person.end() == 0


def lines(**more: Any) -> list[str]:
    return list(localization_lines(localization_report(snapshot(**more), CONFIG, 0)))


def test_lines_report_where_and_how_sure() -> None:
    assert lines(elsewhere=0.2) == [
        "ambiguous, mode global, tank.yaml",
        "pose      x 1.00 ± 0.10 m, y 2.00 ± 0.20 m, yaw 28.6 ± 0.6°, of 5000 particles",
        "elsewhere 20.0 % of the weight: ambiguous",
        "levels    OK: the estimate is within its levels",
        "cluster   80.0 % at x 1.00 ± 0.10 m, y 2.00 ± 0.20 m, yaw 28.6 ± 0.6°",
        "map_odom  x 3.00 m, y -4.00 m, yaw 90.0°",
        "scans     moved 3, no_filter 1",
    ]


def test_lines_report_what_the_model_does_not_do() -> None:
    assert "warning   amcl: a slice" in lines(elsewhere=0.2, warning="amcl: a slice")


def test_lines_before_there_is_anything() -> None:
    assert lines(
        elsewhere=None, state="waiting for a map", known=None, transform=None, counts={}
    ) == [
        "waiting for a map, mode global, no map",
        "levels    OK: no estimate yet",
        "scans     none",
    ]


def test_status_has_a_line_of_it() -> None:
    output = {"localization": localization_summary(snapshot(0.0), CONFIG)}
    _, line = status_lines(output, None)
    assert line == "localization  localized on tank.yaml, x 1.00 m, y 2.00 m, yaw 28.6°"
