from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import (
    Config,
    MappingConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    ProcessingConfig,
)
from mapperd.errors import ReplayError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.replay import Replay, Window
from oculus_driver.recording import open_recording

START_NS = 1_700_000_000_000_000_000
Write = Callable[..., list[int]]
Survey = Callable[..., list[Any]]
PingBytes = Callable[..., bytes]
OdometryBytes = Callable[..., bytes]

COARSE = Config(
    octree=OctreeConfig(voxel_resolution=0.2),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)


def replayed(
    path: Path,
    config: Config = COARSE,
    window: Window | None = None,
    poses: FixedPose | None = None,
) -> tuple[PipelineCounters, SonarMap]:
    sonar_map = SonarMap(config)
    source = OdometryPoses(config) if poses is None else poses
    replay = Replay(sonar_map, source, window or Window(), lambda: 0.0)
    with open_recording(path) as recording:
        for _ in replay.run(recording):
            pass
    counters = replay.counters
    assert counters.pings_total == counters.pings_mapped + counters.pings_dropped.total()
    assert set(counters.first_drop) == set(counters.pings_dropped)
    return counters, sonar_map


def test_every_ping_between_two_records_is_mapped(
    tmp_path: Path, write_recording: Write, survey: Survey
) -> None:
    write_recording(tmp_path / "a", survey(5))
    counters, sonar_map = replayed(tmp_path / "a")
    assert counters.pings_total == counters.pings_mapped == 5
    assert counters.bytes_rejected == 0
    assert counters.bytes_total > 5 * 50 * 65
    assert sonar_map.counts().occupied > 0


def test_two_runs_give_one_map(tmp_path: Path, write_recording: Write, survey: Survey) -> None:
    write_recording(tmp_path / "a", survey(5))
    assert replayed(tmp_path / "a")[1].sha256() == replayed(tmp_path / "a")[1].sha256()


def test_fragmentation_of_the_stream_does_not_matter(
    tmp_path: Path, write_recording: Write, survey: Survey
) -> None:
    events = survey(4)
    write_recording(tmp_path / "whole", events)
    pieces = []
    for kind, data, seconds in events:
        size = 999 if kind == "ping" else len(data)
        pieces += [(kind, data[k : k + size], seconds) for k in range(0, len(data), size)]
    write_recording(tmp_path / "pieces", pieces)
    whole, pieced = replayed(tmp_path / "whole"), replayed(tmp_path / "pieces")
    assert whole[0].pings_mapped == pieced[0].pings_mapped == 4
    assert whole[1].sha256() == pieced[1].sha256()


def test_map_uses_the_pose_at_the_time_of_the_echo(
    tmp_path: Path,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    flight_s = 1.5 * 5.0 / 1500.0  # from the middle of the image's flight to its arrival
    events = [
        ("odometry", odometry_bytes(p=(0.0, 0.0, 0.0)), 0.0),
        ("ping", ping_bytes(1), 0.1 + flight_s),
        ("odometry", odometry_bytes(p=(1.2, 0.0, 0.0)), 0.4),
    ]
    write_recording(tmp_path / "moving", events)
    whole = msgspec.structs.replace(COARSE, mapping=MappingConfig(within_ping_motion=False))
    _, moving = replayed(tmp_path / "moving", whole)
    fixed = FixedPose(pose_from_rpy((0.3, 0, 0), (0, 0, 0)))
    _, still = replayed(tmp_path / "moving", whole, poses=fixed)
    assert moving.sha256() == still.sha256()
    assert fixed.ignored == 2


def test_odometry_that_comes_late_still_serves(
    tmp_path: Path,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    epoch = 1_700_000_000_000_000_000
    unix = [
        odometry_bytes(clk="unix", t=epoch + round(0.1 * k * 1e9), p=(1.0 * k, 0.0, 0.0))
        for k in range(3)
    ]
    events = [
        ("ping", ping_bytes(1), 0.12),
        ("odometry", unix[0], 0.30),
        ("odometry", unix[1], 0.31),
        ("odometry", unix[2], 0.32),
    ]
    write_recording(tmp_path / "a", events)
    counters, sonar_map = replayed(tmp_path / "a")
    assert counters.pings_mapped == 1
    assert sonar_map.voxels("occupied").centres_m[:, 0].max() > 3


def test_pings_without_a_pose_are_dropped_with_the_reason(
    tmp_path: Path,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    events = [
        ("ping", ping_bytes(1, start_time=1.0), 1.0),
        ("odometry", odometry_bytes(), 5.0),
        ("ping", ping_bytes(2, start_time=7.0), 7.0),
        ("odometry", odometry_bytes(), 9.0),
        ("ping", ping_bytes(3, start_time=11.0), 11.0),
    ]
    write_recording(tmp_path / "a", events)
    counters, sonar_map = replayed(tmp_path / "a")
    assert counters.pings_total == 3
    assert counters.pings_mapped == 0
    reasons = ("before_odometry", "odometry_gap", "after_odometry")
    assert counters.pings_dropped == dict.fromkeys(reasons, 1)
    assert sonar_map.counts().free == 0


def test_frame_skip_is_counted(tmp_path: Path, write_recording: Write, survey: Survey) -> None:
    write_recording(tmp_path / "a", survey(7))
    skipping = Config(
        octree=COARSE.octree, mounting=COARSE.mounting, processing=ProcessingConfig(frame_skip=3)
    )
    counters, _ = replayed(tmp_path / "a", skipping)
    assert counters.pings_mapped == 3
    assert counters.pings_dropped == {"frame_skip": 4}


def test_bad_pings_are_counted_and_good_ones_go_on(
    tmp_path: Path, write_recording: Write, ping_bytes: PingBytes, odometry_bytes: OdometryBytes
) -> None:
    backwards = np.linspace(6000, -6000, 65).round().astype(np.int16)
    pings = [
        ping_bytes(1),
        ping_bytes(1),
        ping_bytes(2, range_resolution_m=float("nan")),
        ping_bytes(3, bearings_cdeg=backwards),
        b"\x00" * 500,
        ping_bytes(4),
    ]
    events = [("odometry", odometry_bytes(), 0.1 * k) for k in range(8)]
    events += [("ping", data, 0.1 * k + 0.05) for k, data in enumerate(pings)]
    write_recording(tmp_path / "a", sorted(events, key=lambda event: event[2]))
    counters, _ = replayed(tmp_path / "a")
    assert counters.pings_total == 5
    assert counters.pings_mapped == 2
    assert counters.pings_dropped == {"duplicate": 1, "bad_resolution": 1, "bad_bearings": 1}
    assert counters.bytes_rejected == 500


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        (Window(), [1, 2, 3, 4, 5, 6]),
        (Window(start_s=0.2), [3, 4, 5, 6]),
        (Window(duration_s=0.2), [1, 2]),
        (Window(start_s=0.2, duration_s=0.3), [3, 4, 5]),
        (Window(start_s=99.0), []),
    ],
)
def test_window_chooses_pings_and_keeps_their_poses(
    tmp_path: Path, write_recording: Write, survey: Survey, window: Window, expected: list[int]
) -> None:
    write_recording(tmp_path / "a", survey(6))
    counters, _ = replayed(tmp_path / "a", window=window)
    assert counters.pings_total == counters.pings_mapped == len(expected)


def test_window_needs_time_stamps(tmp_path: Path, ping_bytes: PingBytes) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1) + ping_bytes(2))
    fixed = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    with pytest.raises(ReplayError, match="no time stamps"):
        replayed(tmp_path / "raw", window=Window(start_s=1.0), poses=fixed)


def test_raw_stream_needs_only_a_pose(tmp_path: Path, ping_bytes: PingBytes) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1) + ping_bytes(2))
    fixed = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    assert replayed(tmp_path / "raw", poses=fixed)[0].pings_mapped == 2


def test_times_of_the_step_are_summed_up() -> None:
    counters = PipelineCounters()
    assert counters.ms_per_ping() == {"p50": 0.0, "p95": 0.0, "max": 0.0}
    for seconds in (0.001, 0.002, 0.009):
        counters.add_time(seconds)
    assert counters.ms_per_ping()["p50"] == pytest.approx(2)
    assert counters.ms_per_ping()["max"] == pytest.approx(9)


ASTRAY_S = 1e9


def restamped(events: list[Any], kind: str, number: int, seconds: float) -> list[Any]:
    """The events, the given one of its kind with another stamp."""
    places = [k for k, event in enumerate(events) if event[0] == kind]
    changed = list(events)
    changed[places[number]] = (kind, events[places[number]][1], seconds)
    return changed


def test_ping_with_a_stray_stamp_does_not_end_the_chosen_part(
    tmp_path: Path, write_recording: Write, survey: Survey
) -> None:
    write_recording(tmp_path / "a", restamped(survey(10), "ping", 2, ASTRAY_S))
    counters, _ = replayed(tmp_path / "a", window=Window(duration_s=0.9))
    assert counters.pings_total == counters.pings_mapped == 8
    assert counters.pings_outside == 2


def test_odometry_with_a_stray_stamp_does_not_end_the_chosen_part(
    tmp_path: Path, write_recording: Write, survey: Survey
) -> None:
    write_recording(tmp_path / "a", restamped(survey(10), "odometry", 3, ASTRAY_S))
    counters, _ = replayed(tmp_path / "a", window=Window(duration_s=0.9))
    assert counters.pings_total == counters.pings_mapped == 9


@pytest.mark.parametrize(("kind", "left"), [("odometry", 8), ("ping", 7)])
def test_stray_first_stamp_is_not_the_start(
    tmp_path: Path, write_recording: Write, survey: Survey, kind: str, left: int
) -> None:
    events = survey(10)
    write_recording(tmp_path / "a", restamped(events, kind, 0, 1 - START_NS / 1e9))
    counters, _ = replayed(tmp_path / "a", window=Window(start_s=0.2))
    assert counters.pings_total == left


def test_reading_stops_behind_the_chosen_part_and_blames_no_byte(
    tmp_path: Path,
    write_recording: Write,
    survey: Survey,
    ping_bytes: PingBytes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mapperd.session.replay.MAX_LATE_CHUNKS", 10)
    late = ping_bytes(3)
    pieces = [("ping", late[k : k + 100], 9.0) for k in range(0, len(late), 100)]
    write_recording(tmp_path / "a", [*survey(2), *pieces])
    replay = Replay(SonarMap(COARSE), OdometryPoses(COARSE), Window(duration_s=1.0), lambda: 0.0)
    with open_recording(tmp_path / "a") as recording:
        chunks = list(replay.run(recording))
    assert len(chunks) == 5 + 10
    assert replay.counters.pings_mapped == 2
    assert replay.counters.bytes_rejected == 0
    assert replay.counters.messages_rejected.total() == 0


def test_message_that_ends_behind_the_chosen_part_is_whole(
    tmp_path: Path, write_recording: Write, survey: Survey, ping_bytes: PingBytes
) -> None:
    data = ping_bytes(3)
    split = [("ping", data[:1000], 0.25), ("ping", data[1000:], 9.0)]
    write_recording(tmp_path / "a", [*survey(2), *split])
    counters, _ = replayed(tmp_path / "a", window=Window(duration_s=1.0))
    assert counters.pings_mapped == 3
    assert counters.bytes_rejected == 0


def test_pings_are_placed_by_the_sonars_own_clock(
    tmp_path: Path, write_recording: Write, ping_bytes: PingBytes, odometry_bytes: OdometryBytes
) -> None:
    """A ping that arrives 60 ms late at 3 m/s is mapped where it was, not 18 cm on."""
    stated = [("odometry", odometry_bytes(p=(0.15 * k, 0.0, 0.0)), 0.05 * k) for k in range(60)]
    pings = []
    for k in range(20):
        late_s = 0.06 if k % 2 else 0.0
        pings.append(("ping", ping_bytes(k + 1, start_time=5 + 0.1 * k), 0.5 + 0.1 * k + late_s))
    prompt = [("ping", data, 0.5 + 0.1 * k) for k, (_, data, _) in enumerate(pings)]
    maps = []
    for events in (prompt, pings):
        write_recording(tmp_path / "a", sorted([*stated, *events], key=lambda event: event[2]))
        counters, sonar_map = replayed(tmp_path / "a")
        assert counters.pings_mapped == 20
        maps.append(sonar_map.sha256())
    assert maps[0] == maps[1]
