import re
from pathlib import Path

import pytest

from mapperd.cli.arguments import parse_arguments
from mapperd.geometry.frames import pose_from_rpy


def test_only_the_recording_is_needed() -> None:
    output = parse_arguments(["--replay", "a.bin"])
    assert output.replay == (Path("a.bin"),)
    assert output.out == Path("mapperd-replay")
    assert (output.config, output.pose, output.integrator, output.duration_s) == (None,) * 4
    assert output.start_s == 0


def test_without_a_recording_it_is_live() -> None:
    output = parse_arguments(["--duration", "5"])
    assert (output.replay, output.duration_s) == ((), 5)
    assert output.out == Path("mapperd-live")


def test_a_start_is_of_a_recording(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        parse_arguments(["--start", "5"])
    assert caught.value.code == 2
    assert "--start needs --replay" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--pose", "-1,2,-3,0,90,0"], ["--pose=-1,2,-3,0,90,0"]])
def test_pose_may_begin_with_a_minus(words: list[str]) -> None:
    pose = parse_arguments(["--replay", "a", *words]).pose
    assert pose is not None
    assert pose.map_T_base == pytest.approx(pose_from_rpy((-1, 2, -3), (0, 90, 0)).map_T_base)


@pytest.mark.parametrize(
    "words",
    [
        ["--pose", "1,2,3"],
        ["--pose", "1,2,3,4,5,x"],
        ["--pose", "nan,0,0,0,0,0"],
        ["--pose", "0,0,inf,0,0,0"],
        ["--pose", "1e300,0,0,0,0,0"],
        ["--pose"],
        ["--start", "-1"],
        ["--start", "nan"],
        ["--start", "x"],
        ["--duration", "0"],
        ["--duration", "inf"],
        ["--integrator", "magic"],
        ["--nonsense"],
        ["--out", "x", "stray"],
    ],
)
def test_bad_word_is_one_line_and_exit_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        parse_arguments(["--replay", "a", *words])
    assert caught.value.code == 2
    output = capsys.readouterr().err
    assert output.startswith("mapperd: ")
    assert output.count("\n") == 1


def test_help_names_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        parse_arguments(["--help"])
    assert caught.value.code == 0
    assert "exit codes" in capsys.readouterr().out


def test_several_recordings_are_replayed_in_their_order() -> None:
    output = parse_arguments(["--replay", "b", "a", "--as-recorded", "--out", "x"])
    assert output.replay == (Path("b"), Path("a"))
    assert output.as_recorded


@pytest.mark.parametrize(
    "more",
    [
        ["--config", "a.yaml"],
        ["--pose", "0,0,0,0,0,0"],
        ["--integrator", "rays"],
        ["--start", "1"],
        ["--duration", "1"],
    ],
    ids=str,
)
def test_what_was_recorded_leaves_nothing_to_choose(
    more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse_arguments(["--replay", "a", "--as-recorded", *more])
    assert re.search(rf"--as-recorded .*{more[0]} ", capsys.readouterr().err)


def test_as_recorded_needs_recordings(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse_arguments(["--as-recorded"])
    assert "needs --replay" in capsys.readouterr().err
