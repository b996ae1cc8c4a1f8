"""A source goes silent for 10 s and comes back, from the recording to the map."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import OdometryPoses, ping_time_ns
from mapperd.session.replay import Replay, Window
from oculus_driver.ping import Ping
from oculus_driver.recording import RecordingWriter, open_recording

MakeBytes = Callable[..., bytes]
S = 1_000_000_000
T0 = 1_700_000_000 * S
SPEED_MPS = 0.8
SECONDS = 25.0
SILENT = (8.0, 18.0)
MAP = "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
THREE = MAP + (
    "odometry:\n"
    "  sources:\n"
    "    - {name: ekf}\n"
    "    - {name: ahrs, link: 'udp://127.0.0.1:52201'}\n"
    "    - {name: dvl, format: water_linked_json, link: 'tcp://127.0.0.1:16171'}\n"
    "  owners: {position: ekf, attitude: ahrs, velocity: dvl}\n"
)


class Watched(OdometryPoses):
    """Remembers what each ping got."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.given: list[tuple[float, FusedPose | Reject]] = []

    def resolved(
        self, now_ns: int | None, *, final: bool = False
    ) -> Iterator[tuple[Ping, FusedPose | Reject]]:
        for ping, pose in super().resolved(now_ns, final=final):
            t_ns = ping_time_ns(ping)
            assert t_ns is not None
            self.given.append(((t_ns - T0) / S, pose))
            yield ping, pose


def dvl_report(t_s: float) -> bytes:
    t_us = T0 // 1000 + round(t_s * 1e6)
    report = {
        "type": "velocity",
        "format": "json_v3.1",
        "time": 100.0,
        "vx": SPEED_MPS,
        "vy": 0.0,
        "vz": 0.0,
        "fom": 0.01,
        "covariance": [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]],
        "altitude": 2.0,
        "transducers": [],
        "velocity_valid": True,
        "status": 0,
        "time_of_validity": t_us,
        "time_of_transmission": t_us,
    }
    return json.dumps(report).encode() + b"\r\n"


def record_dive(
    path: Path, silent: set[str], ping_bytes: MakeBytes, odometry_bytes: MakeBytes
) -> None:
    """Straight ahead; each source at its rate, but for those that go silent."""
    pieces: list[tuple[float, str, bytes]] = []
    for k in range(round(SECONDS * 20)):
        t_s = k / 20
        here = {"p": (SPEED_MPS * t_s, 0.0, 0.0), "q": None}
        pieces.append((t_s, "ekf", odometry_bytes(**here)))
        pieces.append((t_s, "ahrs", odometry_bytes(p=None)))
        pieces.append((t_s, "dvl", dvl_report(t_s)))
        pieces.append((t_s + 0.025, "sonar", ping_bytes(k + 1, start_time=t_s + 60)))
    with RecordingWriter(path, overwrite=True) as writer:
        links = {
            "sonar": writer.add_link("sonar", "oculus"),
            "ekf": writer.add_link("ekf", "odometry-native"),
            "ahrs": writer.add_link("ahrs", "odometry-native"),
            "dvl": writer.add_link("dvl", "odometry-water_linked_json"),
        }
        for t_s, name, data in pieces:
            if name not in silent or not SILENT[0] < t_s < SILENT[1]:
                writer.write(links[name], data, T0 + round(t_s * S))


def replayed(path: Path, config: Config) -> tuple[PipelineCounters, Watched]:
    sonar_map, poses = SonarMap(config), Watched(config)
    replay = Replay(sonar_map, poses, Window(), lambda: 0.0)
    with open_recording(path) as recording:
        for _ in replay.run(recording):
            # No ping is kept waiting for what does not come: a second and a half of them at most.
            assert poses.waiting_bytes <= 30 * 50 * 65
    counters = replay.counters
    assert counters.pings_total == counters.pings_mapped + counters.pings_dropped.total()
    return counters, poses


def worst_m(poses: Watched) -> float:
    """Of the poses that pings were mapped with: how far from the truth."""
    return max(
        float(np.linalg.norm(pose.pose.position_m - [SPEED_MPS * t_s, 0.0, 0.0]))
        for t_s, pose in poses.given
        if isinstance(pose, FusedPose)
    )


@pytest.mark.parametrize("silent", [{"ekf", "dvl"}, {"ahrs"}, {"ekf", "ahrs", "dvl"}])
def test_silence_costs_the_pings_in_it(
    tmp_path: Path, ping_bytes: MakeBytes, odometry_bytes: MakeBytes, silent: set[str]
) -> None:
    record_dive(tmp_path / "a", silent, ping_bytes, odometry_bytes)
    counters, poses = replayed(tmp_path / "a", config_from_text(THREE))
    assert worst_m(poses) < 0.01
    assert set(counters.pings_dropped) <= {"odometry_gap", "after_odometry"}
    # Motion is carried on for 0.1 s by the records beside it, and for 0.5 s by the last velocity.
    assert 186 <= counters.pings_dropped.total() <= 198
    lost = [t_s for t_s, pose in poses.given if isinstance(pose, Reject)]
    assert SILENT[0] < min(lost)
    assert max(lost) < SILENT[1]
    assert counters.first_drop.keys() == counters.pings_dropped.keys()


@pytest.mark.slow
def test_position_that_falls_silent_is_reckoned_on(
    tmp_path: Path, ping_bytes: MakeBytes, odometry_bytes: MakeBytes
) -> None:
    record_dive(tmp_path / "a", {"ekf"}, ping_bytes, odometry_bytes)
    counters, poses = replayed(tmp_path / "a", config_from_text(THREE))
    assert counters.pings_dropped.total() == 0
    assert worst_m(poses) < 0.01
    reckoned = {t_s: pose.reckoned_s for t_s, pose in poses.given if isinstance(pose, FusedPose)}
    assert max(reckoned.values()) == pytest.approx(10.0, abs=0.1)
    doubts = [
        math.sqrt(pose.covariance[0, 0])
        for t_s, pose in poses.given
        if isinstance(pose, FusedPose) and 9 < t_s < 17
    ]
    assert doubts == sorted(doubts)


def test_velocity_that_falls_silent_costs_nothing(
    tmp_path: Path, ping_bytes: MakeBytes, odometry_bytes: MakeBytes
) -> None:
    record_dive(tmp_path / "a", {"dvl"}, ping_bytes, odometry_bytes)
    counters, poses = replayed(tmp_path / "a", config_from_text(THREE))
    assert counters.pings_dropped.total() == 0
    assert worst_m(poses) < 0.01
