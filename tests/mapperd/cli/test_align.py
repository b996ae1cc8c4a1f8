"""`mapperd --replay --align`: maps with the aligned trajectory, or as usual."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.alignment.align import AlignedDive, Alignment, DiveInput
from mapperd.alignment.submaps import compose
from mapperd.cli.mapperd import main
from oculus_driver.command_line import ExitCode
from oculus_driver.recording import RecordingWriter, open_recording
from tests.mapperd.conftest import Event

Align = Callable[..., Alignment]
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def recording(
    tmp_path: Path,
    write_recording: Callable[[Path, Iterable[Event]], object],
    survey: Callable[..., list[Event]],
) -> Path:
    path = tmp_path / "dive.mcap"
    write_recording(path, survey(5))
    return path


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.daemon.map_folder.write_picture", lambda *_: None)
    monkeypatch.setattr("mapperd.alignment.report._draw", lambda *_: [])


def shifting(shift: Sequence[float], *, corrected: bool) -> Align:
    """An alignment that moves the whole dive."""

    def align(dives: Sequence[DiveInput], *_: object, **__: object) -> Alignment:
        [given] = dives
        track = given.read(None).track
        t_ns = track.t_ns[[0, -1]]
        odometry = track.at(t_ns)
        poses = compose(np.array([shift]), odometry)
        covariance = np.stack([np.diag([0.01, 0.01, 1e-4])] * 2)
        dive = AlignedDive(
            given.name, t_ns, odometry, odometry, covariance, np.zeros((2, 3)), np.zeros(3), track
        )
        if corrected:
            dive = replace(dive, poses=poses)
        return Alignment([dive], [], corrected, "" if corrected else "nothing was seen twice", 0)

    return align


def run(recording: Path, config: Path, out: Path, *more: str) -> dict[str, Any]:
    words = ["--replay", str(recording), "--config", str(config), "--out", str(out), *more]
    assert main(words) == ExitCode.OK
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
    return summary


def test_a_dive_that_cannot_be_aligned_is_mapped_as_usual(
    recording: Path, quick_config: Path, tmp_path: Path, capsys: Capture
) -> None:
    plain = run(recording, quick_config, tmp_path / "plain")
    assert "alignment" not in plain
    assert not (tmp_path / "plain" / "alignment").exists()
    capsys.readouterr()
    aligned = run(recording, quick_config, tmp_path / "aligned", "--align")
    assert aligned["map_sha256"] == plain["map_sha256"]
    assert aligned["alignment"]["corrected"] is False
    assert aligned["alignment"]["reason"]
    assert "not corrected, because" in capsys.readouterr().err
    files = {path.name for path in (tmp_path / "aligned" / "alignment").iterdir()}
    assert files == {
        "alignment.json",
        "graph.g2o",
        "report.md",
        "trajectory.mcap",
        "trajectory.tum",
    }


def test_the_map_is_that_of_the_trajectory_written(
    recording: Path, quick_config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.alignment.align.align", shifting((7.0, -3.0, 0.5), corrected=True))
    aligned = run(recording, quick_config, tmp_path / "aligned", "--align")
    assert aligned["alignment"]["corrected"] is True
    written = tmp_path / "aligned" / "alignment" / "trajectory.mcap"
    again = run(recording, quick_config, tmp_path / "again", "--odometry", str(written))
    assert aligned["map_sha256"] == again["map_sha256"]
    assert aligned["pings_mapped"] == again["pings_mapped"] == 5
    plain = run(recording, quick_config, tmp_path / "plain")
    places = [
        np.loadtxt(tmp_path / name / "trajectory.tum")[-1, 1:4] for name in ("plain", "aligned")
    ]
    c, s = np.cos(0.5), np.sin(0.5)
    x, y, z = places[0]
    assert places[1] == pytest.approx([7 + c * x - s * y, -3 + s * x + c * y, z], abs=0.01)
    assert plain["map_sha256"] != aligned["map_sha256"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--align"], "--replay"),
        (["--replay", "a.mcap", "--fixes", "gps.csv"], "--fixes"),
        (["--replay", "a.mcap", "--align", "--store", "a.map"], "--store"),
        (["--replay", "a.mcap", "--align", "--pose", "0,0,0,0,0,0"], "--pose"),
        (["--replay", "a.mcap", "--align", "--as-recorded"], "--as-recorded"),
    ],
)
def test_options_that_contradict_it_are_named(
    words: list[str], named: str, capsys: Capture
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == ExitCode.USAGE
    [line] = capsys.readouterr().err.splitlines()[-1:]
    assert "--align" in line
    assert named in line


def test_several_sessions_are_refused(
    recording: Path, quick_config: Path, tmp_path: Path, capsys: Capture
) -> None:
    other = tmp_path / "other.mcap"
    with (
        RecordingWriter(other, metadata={"session": "b"}) as writer,
        open_recording(recording) as first,
    ):
        links: dict[str, int] = {}
        for chunk in first:
            if chunk.link not in links:
                links[chunk.link] = writer.add_link(chunk.link, chunk.encoding)
            writer.write(links[chunk.link], chunk.data, chunk.arrival_ns)
    words = ["--config", str(quick_config), "--out", str(tmp_path / "out"), "--align"]
    assert main(["--replay", str(recording), str(other), *words]) == ExitCode.USAGE
    assert "one session" in capsys.readouterr().err.splitlines()[-1]


def test_a_missing_extra_is_named(
    recording: Path,
    quick_config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.setattr("mapperd.cli.replay.find_spec", lambda _: None)
    words = ["--replay", str(recording), "--config", str(quick_config), "--align"]
    assert main([*words, "--out", str(tmp_path / "out")]) == ExitCode.BAD_CONFIG
    assert "align" in capsys.readouterr().err
    assert not (tmp_path / "out" / "summary.json").exists()
