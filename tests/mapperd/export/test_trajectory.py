"""Trajectories in folders of results: the poses at which pings were mapped."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.config.daemon import FramesConfig
from mapperd.errors import ExportError
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.geometry.frames import pose_from_rpy

Run = Callable[..., Any]
FRAMES = FramesConfig(map="sea", base="rov")


@pytest.mark.usefixtures("no_picture")
def test_a_replay_writes_the_pose_of_each_mapped_ping(
    tmp_path: Path,
    write_recording: Callable[..., list[int]],
    survey: Callable[..., list[Any]],
    run: Run,
) -> None:
    write_recording(tmp_path / "dive.mcap", survey(5))
    ran = run(tmp_path / "dive.mcap")
    tum = np.loadtxt(ran.out / "trajectory.tum")
    assert tum.shape == (ran.summary["pings_mapped"], 8)
    np.testing.assert_allclose(np.diff(tum[:, 0]), 0.1, atol=1e-3)
    np.testing.assert_allclose(tum[:, 1], 0.0225 + 0.05 * np.arange(5), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tum[:, 4:], axis=1), 1.0, atol=1e-8)
    with (ran.out / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    np.testing.assert_array_equal([[float(row[name]) for name in names] for row in rows], tum)
    assert {(row["frame"], row["child_frame"]) for row in rows} == {("map", "base_link")}


@pytest.mark.usefixtures("no_picture")
def test_a_replay_into_a_map_file_writes_it_too(
    tmp_path: Path,
    write_recording: Callable[..., list[int]],
    survey: Callable[..., list[Any]],
    run: Run,
) -> None:
    write_recording(tmp_path / "dive.mcap", survey(5))
    ran = run(tmp_path / "dive.mcap", "--store", str(tmp_path / "dive.map"))
    assert len(np.loadtxt(ran.out / "trajectory.tum")) == 5


def test_times_keep_their_nanoseconds_and_quaternions_their_order(tmp_path: Path) -> None:
    trajectory = TrajectoryWriter(tmp_path)
    trajectory.add(1_700_000_000_000_000_001, pose_from_rpy((1, -2, -3.5), (180.0, 0, 0)))
    trajectory.add(None, pose_from_rpy((9, 9, 9), (0, 0, 0)))
    trajectory.write(FRAMES)
    trajectory.close()
    head, line = (tmp_path / "trajectory.tum").read_text("ascii").splitlines()
    assert head == "# timestamp tx ty tz qx qy qz qw"
    time, *numbers = line.split()
    assert time == "1700000000.000000001"
    np.testing.assert_allclose(
        [float(one) for one in numbers], [1, -2, -3.5, 1, 0, 0, 0], atol=1e-9
    )
    assert (tmp_path / "trajectory.csv").read_text("ascii").splitlines()[1].endswith(",sea,rov")


def test_without_a_pose_the_files_of_an_earlier_run_go(tmp_path: Path) -> None:
    for name in ("trajectory.tum", "trajectory.csv"):
        (tmp_path / name).touch()
    TrajectoryWriter(tmp_path).write(FRAMES)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_costs_the_trajectory_and_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    trajectory = TrajectoryWriter(tmp_path)
    for _ in range(2):
        trajectory.add(1, pose_from_rpy((0, 0, 0), (0, 0, 0)))
        trajectory.flush()
    with pytest.raises(ExportError, match=r"trajectory.tum: not written: No space left on device"):
        trajectory.write(FRAMES)
