"""Recordings of passes through `mapperd --replay`, and its localization on the way."""

import dataclasses
import math
import subprocess
import sys
import time
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray
from sonar_sim import FramePose, Scenario
from sonar_sim.capture import EPOCH_NS, CaptureSettings, ping_times_s, write_capture
from sonar_sim.geometry.pose import Mounting, rotation_of
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.scene.vehicle import OdometrySample
from tqdm import tqdm

from mapperd.config.tree import (
    Config,
    FilteringConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
)
from mapperd.geometry.frames import Pose as BasePose
from mapperd.localization.scan import yaw_of
from mapperd.localization.session import begun
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.replay import Replay, Window
from oculus_driver.recording import open_recording
from studies.localization.runs import settings
from studies.localization.world import DiveArea, DiveTrack, OdometryDrift, angles, drifted

__all__ = [
    "AHEAD",
    "FIRST",
    "SECOND",
    "Pass",
    "PassCourse",
    "course",
    "localized",
    "mapped",
    "navigation",
    "ping_poses",
    "plain",
    "record",
]


Floats = NDArray[np.float64]
Corner = tuple[float, float, float]
"""x and y in metres, heading in degrees."""

RECORD_HZ = 25.0
LATENCY_S = 0.002
NOISE_M, NOISE_DEG = 0.005, 0.1
"""White errors of a record, as the simulator's vehicles have them."""
TURN_RATE_DPS = 15.0
AHEAD = Mounting(position_m=(0.3, 0.0, 0.0), pitch_deg=0.0)
"""At the bow, looking along it."""
FRESH = OdometryDrift(0.002, math.radians(0.1) / 60.0)
"""A tenth of what odometry drifts by: a first pass under a fix."""


@dataclass(frozen=True, slots=True)
class Pass:
    """A way past a place.

    Attributes:
        corners: with the heading in each; between them the vehicle goes straight.
        away: corners before, with the sonar silent: the odometry begins there at the truth.
        drift: of the odometry, from there on.
        ping_rate_hz: asked for.
        seed: of noise and odometry.
    """

    corners: tuple[Corner, ...]
    away: tuple[Corner, ...] = ()
    drift: OdometryDrift = field(default_factory=OdometryDrift)
    ping_rate_hz: float = 4.0
    seed: int = 1

    def over(self, scenario: Scenario, place: DiveArea) -> Scenario:
        """The scenario with this path."""
        path = _trajectory((*self.away, *self.corners), place)
        rate_hz = self.ping_rate_hz
        return dataclasses.replace(scenario, trajectory=path, mounting=AHEAD, ping_rate_hz=rate_hz)

    def quiet_s(self, place: DiveArea) -> float:
        """Before the sonar sounds."""
        if not self.away:
            return 0.0
        return _trajectory((*self.away, self.corners[0]), place).duration_s


FIRST = Pass(
    ((-15, -2, 50), (15, -2, 50), (15, -2, 130), (15, -6, 130), (-15, -6, 130)), drift=FRESH
)
SECOND = Pass(
    ((15, -4.5, 115), (-15, -3, 115), (-15, -3, 70), (-15, -7, 70), (15, -5, 70)),
    away=((-15, -6, 130), (-15, -10, 0), (15, -9, 0), (15, -5, 180), (-15, -9, 180), (15, -9, 0)),
    seed=2,
)


def record(
    path: Path, what: Pass, scenario: Scenario, place: DiveArea, processes: int = 1
) -> Floats:
    """Simulate a pass into a recording.

    Args:
        path: of the recording.
        what: the pass.
        scenario: scene and sonar.
        place: speed and height.
        processes: that simulate; changes nothing in the file.

    Returns:
        (N, 3) points of the surfaces that the sonar had in sight, map frame.
    """
    driven = what.over(scenario, place)
    settings = CaptureSettings(what.seed, quiet_s=what.quiet_s(place), processes=processes)
    records = navigation(driven.trajectory, place, what)
    with tqdm(desc=path.stem, unit="ping", disable=None) as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        return write_capture(path, driven, settings, progress, records).points_m


def ping_poses(what: Pass, scenario: Scenario, place: DiveArea) -> tuple[Floats, list[FramePose]]:
    """When the pings leave, in seconds on the path, and where the vehicle truly is then."""
    driven = what.over(scenario, place)
    times_s = ping_times_s(driven, CaptureSettings(quiet_s=what.quiet_s(place)))
    return np.array(times_s), [driven.trajectory.pose(t) for t in times_s]


def navigation(path: Trajectory, place: DiveArea, what: Pass) -> list[OdometrySample]:
    """Odometry of a path: right at its beginning, from there on with its drift.

    Depth, roll and pitch are a sensor's and do not drift.
    """
    time_s = np.arange(0.0, path.duration_s, 1.0 / RECORD_HZ)
    poses = [path.pose(float(t)) for t in time_s]
    true = np.array([[*pose.position_m, *angles(pose.rotation)] for pose in poses])
    drifting = _begun_at(true[0], drifted(DiveTrack(time_s, true), place, what.drift, what.seed))
    place_m = np.column_stack([drifting[:, :2], true[:, 2]])
    speed_mps = np.gradient(place_m, time_s, axis=0)
    noise = np.random.default_rng((what.seed, 4)).normal(size=(2, *place_m.shape))
    samples = []
    for k, t in enumerate(time_s.tolist()):
        rotation = rotation_of(true[k, 3], true[k, 4], drifting[k, 2])
        tilt = rotation_of(*np.radians(NOISE_DEG * noise[1, k]))
        samples.append(
            OdometrySample(
                t,
                t + LATENCY_S,
                FramePose(place_m[k] + NOISE_M * noise[0, k], rotation @ tilt),
                rotation.T @ speed_mps[k],
                path.turn_rates_rps(t),
            )
        )
    return samples


def _trajectory(corners: tuple[Corner, ...], place: DiveArea) -> Trajectory:
    points = [Waypoint(x, y, place.z_m, yaw) for x, y, yaw in corners]
    return Trajectory(points, Motion(place.speed_mps, TURN_RATE_DPS, heave_m=0.02))


def _begun_at(first: Floats, drifting: Floats) -> Floats:
    """(N, 3) the odometry's places and headings in the map, its first one the true one."""
    turn = first[5] - drifting[0, 2]
    c, s = math.cos(turn), math.sin(turn)
    placed = (drifting[:, :2] - drifting[0, :2]) @ np.array([[c, s], [-s, c]]) + first[:2]
    return np.column_stack([placed, drifting[:, 2] + turn])


replace = msgspec.structs.replace

THRESHOLD = 60.0
"""Samples above it are returns to the map: above the noise that the gain brings up at 20 m."""
START_M, START_RAD = 0.5, math.radians(6.0)
"""Standard deviations of what is known of where the second pass begins."""


@dataclass(frozen=True, slots=True, eq=False)
class PassCourse:
    """The vehicle at the updates of the filter.

    Attributes:
        time_s: (N,) on the path.
        true, estimate, odometry: (N, 3) x, y, yaw; where it was, where localization and where the
            odometry has it.
    """

    time_s: Floats
    true: Floats
    estimate: Floats
    odometry: Floats

    def errors_m(self, place: Floats) -> Floats:
        """(N,) how far `estimate` or `odometry` is from the truth."""
        off: Floats = np.hypot(*(place - self.true)[:, :2].T)
        return off

    def errors_rad(self, place: Floats) -> Floats:
        """(N,) by how much the heading is off, without a sign."""
        turn = (place - self.true)[:, 2]
        off: Floats = np.abs(np.angle(np.exp(1j * turn)))
        return off


def plain(place: DiveArea, seed: int) -> Config:
    """Settings that map at the poses of the odometry."""
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


def localized(place: DiveArea, seed: int, known: Path, start: FramePose) -> Config:
    """Settings that map at the poses of localization on a map, begun near a pose."""
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


def course(recording: Path, config: Config, path: Trajectory) -> PassCourse:
    """Localization on the way, by the same bytes and settings as `mapped`.

    Args:
        recording: of a pass.
        config: `localized`.
        path: that was truly driven.
    """
    blind = replace(config, localization=replace(config.localization, mapping="off"))
    localizing = begun(blind)
    if localizing is None:
        raise ValueError("localization is off")
    stage = localizing.stage
    poses = OdometryPoses(blind)
    replay = Replay(SonarMap(blind), poses, Window(), time.process_time, localization=stage)
    rows, updates = [], 0
    with open_recording(recording) as chunks:
        for _ in chain(replay.run(chunks), [None]):  # its end settles the last pings
            snapshot = stage.snapshot()
            if snapshot.updates == updates or snapshot.odom is None or snapshot.pose is None:
                continue
            updates = snapshot.updates
            time_s = ((snapshot.stamp_ns or 0) - EPOCH_NS) / 1e9
            true = path.pose(time_s)
            at = (
                _planar(true.position_m, true.quaternion),
                *map(_of_base, (snapshot.pose, snapshot.odom)),
            )
            rows.append([time_s, *np.concatenate(at)])
    table = np.array(rows)
    return PassCourse(table[:, 0], *(table[:, 1 + 3 * k : 4 + 3 * k] for k in range(3)))


def _of_base(pose: BasePose) -> Floats:
    return _planar(pose.position_m, pose.map_q_base)


def _planar(place_m: Floats, quaternion: Floats) -> Floats:
    return np.array([place_m[0], place_m[1], yaw_of(quaternion)])
