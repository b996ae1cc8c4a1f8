"""Odometry of other files in a session's chunks: its place is the same wherever reading begins."""

from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.config.tree import VisualizationConfig
from mapperd.odometry.odometry_files import (
    OdometryFiles,
    OdometryMerge,
    OdometryOptions,
    read_odometry,
)
from mapperd.odometry.trajectory_files import POSES_LINK, pose_chunk
from mapperd.pipeline.counters import PipelineCounters
from mapperd.session.recordings import RecordedSession, Tail
from mapperd.session.replay_to_store import map_into_store
from mapperd.store.position import RecordingOffset
from oculus_driver.recording import OCULUS, Chunk
from tests.mapperd.conftest import START_NS
from tests.mapperd.session.crash import test_startup as sessions

Write = Callable[..., list[int]]
Survey = Callable[..., list[Any]]
SECOND = 10**9


class StopError(Exception):
    """Stands for the end of the process."""


def poses(times_s: list[float]) -> list[Chunk]:
    return [
        pose_chunk(START_NS + round(t * SECOND), (t, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        for t in times_s
    ]


def sonar(time_s: float | None, *, damaged: bool = False) -> Chunk:
    stamp_ns = None if time_s is None else START_NS + round(time_s * SECOND)
    return Chunk("sonar", OCULUS, stamp_ns, b"", damaged=damaged)


def order(chunks: list[Chunk], times_s: list[float]) -> str:
    """Merge; S is of the sonar, p a pose."""
    merged = OdometryMerge(iter(poses(times_s))).into(chunks, is_last=True)
    return "".join("p" if chunk.link == POSES_LINK else "S" for chunk in merged)


def test_poses_come_before_what_arrived_after_them() -> None:
    assert order([sonar(1), sonar(2)], [0.5, 1.0, 1.5, 3.0]) == "ppSpSp"


def test_a_single_stamp_far_ahead_moves_nothing() -> None:
    assert order([sonar(1), sonar(9e6), sonar(2)], [0.5, 1.5, 1.7]) == "pSppSS"
    assert order([sonar(1), sonar(5, damaged=True), sonar(2)], [0.5, 1.5]) == "pSSpS"
    assert order([sonar(1), sonar(None), sonar(2)], [0.5, 1.5]) == "pSSpS"


def test_poses_long_before_and_after_are_left_out() -> None:
    assert order([sonar(100), sonar(101)], [0, 39, 41, 100.5, 105, 112]) == "pSpSp"


def test_recorded_odometry_is_left_out() -> None:
    recorded = replace(poses([1.0])[0], link="vehicle")
    assert order([sonar(1), recorded, sonar(2)], [0.5]) == "pSS"


@pytest.fixture
def odometry(tmp_path: Path) -> OdometryFiles:
    path = tmp_path / "a.tum"
    lines = [f"{START_NS // SECOND + 0.04 * k:.2f} {0.02 * k} 0 0 0 0 0 1" for k in range(90)]
    path.write_text("\n".join(lines))
    config = sessions.config_of(tmp_path)
    return read_odometry(OdometryOptions((path,)), config)


def test_a_tail_continues_anywhere(
    tmp_path: Path, write_recording: Write, survey: Survey, odometry: OdometryFiles
) -> None:
    events = survey(30)
    files = {}
    for number, part in enumerate((events[:20], events[20:41], events[41:]), 1):
        write_recording(tmp_path / f"{number}.mcap", part)
        files[number] = tmp_path / f"{number}.mcap"
    tail = Tail(files, RecordingOffset(), odometry=odometry)
    whole = [(chunk, tail.place) for chunk in tail]
    assert [chunk for chunk, _ in whole] == list(
        RecordedSession(list(files.values()), None, odometry=odometry)
    )
    assert sum(chunk.link == POSES_LINK for chunk, _ in whole) == 90
    stamps = [chunk.arrival_ns or 0 for chunk, _ in whole]
    assert all(before <= after for before, after in pairwise(stamps))
    for k in range(0, len(whole), 7):
        rest = Tail(files, whole[k][1], odometry=odometry)
        assert [(chunk, rest.place) for chunk in rest] == whole[k + 1 :]
        assert rest.loss == ""


def test_a_store_resumes(
    tmp_path: Path, write_recording: Write, survey: Survey, odometry: OdometryFiles
) -> None:
    recording = tmp_path / "dive.mcap"
    write_recording(recording, survey(30))
    config = msgspec.structs.replace(
        sessions.config_of(tmp_path), visualization=VisualizationConfig(tile_save_interval=1e-4)
    )

    def mapped(path: Path, most: int) -> str:
        """Map into a file; stop after so many chunks."""
        left = most

        def count(_: PipelineCounters) -> None:
            nonlocal left
            left -= 1
            if not left:
                raise StopError

        whole, *_ = map_into_store([recording], config, None, path, count, odometry=odometry)
        with closing(whole):
            return whole.sha256()

    expected = mapped(tmp_path / "one.map", 1000)
    found = ""
    for most in range(30, 200, 8):  # when the map is saved depends on the time
        with suppress(StopError):
            found = mapped(tmp_path / "two.map", most)
            break
    assert most > 30
    assert found == expected
