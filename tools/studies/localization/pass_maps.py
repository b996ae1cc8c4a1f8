"""Recordings of passes through `mapperd --replay`, and what its localization says on the way."""

import math
import subprocess
import sys
import time
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray
from sonar_sim import Pose
from sonar_sim.capture import EPOCH_NS
from sonar_sim.trajectory import Trajectory

from mapperd.config.tree import (
    Config,
    FilteringConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
)
from mapperd.geometry.frames import Pose as BasePose
from mapperd.localization.levelling import yaw_of
from mapperd.localization.session import begun
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.replay import Replay, Window
from oculus_driver.recording import open_recording
from studies.localization.pass_dive import AHEAD
from studies.localization.runs import settings
from studies.localization.world import Place

__all__ = ["Course", "course", "localized", "mapped", "plain"]

Floats = NDArray[np.float64]
replace = msgspec.structs.replace

THRESHOLD = 60.0
"""Samples above it are returns to the map: above the noise that the gain brings up at 20 m."""
START_M, START_RAD = 0.5, math.radians(6.0)
"""Standard deviations of what is known of where the second pass begins."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The vehicle at the updates of the filter.

    Attributes:
        time_s: (N,) on the path.
        true, said, odometry: (N, 3) x, y, yaw; where it was, where localization and where the
            odometry has it.
    """

    time_s: Floats
    true: Floats
    said: Floats
    odometry: Floats

    def errors_m(self, place: Floats) -> Floats:
        """(N,) how far `said` or `odometry` is from the truth."""
        off: Floats = np.hypot(*(place - self.true)[:, :2].T)
        return off

    def errors_rad(self, place: Floats) -> Floats:
        """(N,) by how much the heading is off, without a sign."""
        turn = (place - self.true)[:, 2]
        off: Floats = np.abs(np.angle(np.exp(1j * turn)))
        return off


def plain(place: Place, seed: int) -> Config:
    """Settings that map where the odometry says."""
    config = settings(place, seed)
    mounting = MountingConfig(
        PositionConfig(*AHEAD.position_m),
        OrientationConfig(AHEAD.roll_deg, AHEAD.pitch_deg, AHEAD.yaw_deg),
    )
    return replace(
        config,
        mounting=mounting,
        octree=OctreeConfig(voxel_resolution=place.voxel_m),
        filtering=FilteringConfig(intensity_threshold=THRESHOLD),
        localization=replace(config.localization, mode="off"),
    )


def localized(place: Place, seed: int, known: Path, start: Pose) -> Config:
    """Settings that map where localization on a map says, begun near a pose."""
    config = plain(place, seed)
    sigma = np.array([START_M, START_M, START_RAD])
    off = sigma * np.random.default_rng((seed, 3)).normal(size=3)
    amcl = replace(
        config.amcl,
        set_initial_pose=True,
        initial_pose_x=float(start.position_m[0] + off[0]),
        initial_pose_y=float(start.position_m[1] + off[1]),
        initial_pose_a=float(_planar(start.position_m, start.quaternion)[2] + off[2]),
        initial_cov_xx=START_M**2,
        initial_cov_yy=START_M**2,
        initial_cov_aa=START_RAD**2,
    )
    ours = replace(
        config.localization,
        mode="track",
        mapping="corrected",
        map_path=str(known),
        boundaries_only=True,  # a sonar made the map: its walls are as deep as echoes are long
    )
    return replace(config, amcl=amcl, localization=ours)


def mapped(recording: Path, config: Config, out: Path) -> int:
    """Have `mapperd --replay` map a recording into a folder; returns how many pings went in.

    Raises:
        subprocess.CalledProcessError: it fails.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / "config.yaml"
    path.write_text(yaml.safe_dump(msgspec.to_builtins(config)))
    files = {"--replay": recording, "--config": path, "--out": out}
    words = [str(word) for option in files.items() for word in option]
    subprocess.run([sys.executable, "-m", "mapperd", *words], check=True)  # noqa: S603 our own
    return int(msgspec.json.decode((out / "summary.json").read_bytes())["pings_mapped"])


def course(recording: Path, config: Config, path: Trajectory) -> Course:
    """What localization says on the way, by the same bytes and settings as `mapped`.

    Args:
        recording: of a pass.
        config: `localized`.
        path: that was truly driven.
    """
    blind = replace(config, localization=replace(config.localization, mapping="off"))
    localizing = begun(blind)
    if localizing is None:
        raise ValueError("localization is off")
    onboard = localizing.onboard
    poses = OdometryPoses(blind)
    replay = Replay(SonarMap(blind), poses, Window(), time.process_time, onboard=onboard)
    rows, updates = [], 0
    with open_recording(recording) as chunks:
        for _ in chain(replay.run(chunks), [None]):  # its end settles the last pings
            facts = onboard.facts()
            if facts.updates == updates or facts.odom is None or facts.pose is None:
                continue
            updates = facts.updates
            time_s = ((facts.stamp_ns or 0) - EPOCH_NS) / 1e9
            true = path.pose(time_s)
            at = (
                _planar(true.position_m, true.quaternion),
                *map(_of_base, (facts.pose, facts.odom)),
            )
            rows.append([time_s, *np.concatenate(at)])
    table = np.array(rows)
    return Course(table[:, 0], *(table[:, 1 + 3 * k : 4 + 3 * k] for k in range(3)))


def _of_base(pose: BasePose) -> Floats:
    return _planar(pose.position_m, pose.map_q_base)


def _planar(place_m: Floats, quaternion: Floats) -> Floats:
    return np.array([place_m[0], place_m[1], yaw_of(quaternion)])
