"""What an alignment is worth: the error of a trajectory, of its loops, and of the map made with it.

Trajectories are compared with the truth at the pings, anchored at the first of them by a turn about
the vertical and a shift alone: depth, roll and pitch are sensed. `evo` reads files and computes the
errors (M. Grupp, "evo: Python package for the evaluation of odometry and SLAM", 2017).
"""

import csv
import math
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from evo.core.metrics import APE, PoseRelation, StatisticsType
from evo.core.trajectory import PoseTrajectory3D
from evo.tools.file_interface import read_tum_trajectory_file
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.native import decode_native
from mapperd.odometry.odometry_files import OdometryOptions, read_odometry
from mapperd.odometry.records import Odometry
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.replay import Replay, Window
from oculus_driver.recording import ODOMETRY_NATIVE, open_recording

__all__ = [
    "LoopErrors",
    "MapErrors",
    "PoseTrack",
    "TrackErrors",
    "anchor",
    "loop_errors",
    "map_errors",
    "mapped_voxels",
    "read_loops",
    "read_odometry_track",
    "read_tum",
    "track_errors",
    "write_tum",
]

Floats = NDArray[np.float64]

WRONG_M, WRONG_DEG = 0.5, 3.0
"""A loop that is off by more is wrong."""
VOXELS_JUDGED = 50_000
"""Of a map, chosen at random: their median is exact to some millimetres."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseTrack:
    """Poses of a base over time.

    Attributes:
        time_s: (N,) Unix time, increasing.
        position_m: (N, 3).
        quaternion: (N, 4) w, x, y, z, frame from base.
    """

    time_s: Floats
    position_m: Floats
    quaternion: Floats

    def at(self, time_s: Floats) -> "PoseTrack":
        """Interpolate to times (M,) within the track's own."""
        start_s = self.time_s[0]
        moved = np.stack(
            [np.interp(time_s, self.time_s, column) for column in self.position_m.T], axis=1
        )
        turns = Slerp(self.time_s - start_s, Rotation.from_quat(_xyzw(self.quaternion)))
        turned = turns(np.clip(time_s - start_s, 0.0, self.time_s[-1] - start_s)).as_quat()
        return PoseTrack(time_s, moved, turned[:, [3, 0, 1, 2]])

    def planar(self) -> Floats:
        """(N, 3) x, y and yaw; the yaw is continuous."""
        w, x, y, z = self.quaternion.T
        yaw = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
        return np.column_stack([self.position_m[:, :2], yaw])

    def evo(self) -> PoseTrajectory3D:
        """The same for evo."""
        return PoseTrajectory3D(self.position_m, self.quaternion, self.time_s)


def _xyzw(wxyz: Floats) -> Floats:
    return wxyz[:, [1, 2, 3, 0]]


def read_tum(path: Path) -> PoseTrack:
    """Read a trajectory in TUM's format.

    Raises:
        FileInterfaceException: evo cannot read it.
    """
    read = read_tum_trajectory_file(path)
    return PoseTrack(read.timestamps, read.positions_xyz, read.orientations_quat_wxyz)


def write_tum(path: Path, track: PoseTrack) -> None:
    """Write a trajectory in TUM's format."""
    rows = np.column_stack([track.time_s, track.position_m, _xyzw(track.quaternion)])
    np.savetxt(path, rows, fmt="%.9f")


def read_odometry_track(path: Path) -> PoseTrack:
    """Read the native records with poses of a recording.

    Raises:
        TypeError: one of them is malformed.
    """
    records = []
    with open_recording(path) as recording:
        for chunk in recording:
            if chunk.encoding != ODOMETRY_NATIVE:
                continue
            record = decode_native(chunk.data)
            if not isinstance(record, Odometry):
                raise TypeError(f"{path}: {record}")
            records.append(record)
    return PoseTrack(
        np.array([record.stamp_ns for record in records]) / 1e9,
        np.array([record.position_m for record in records]),
        np.array([record.map_q_base for record in records]),
    )


def anchor(estimate: Floats, truth: Floats) -> Floats:
    """(4, 4) turn about the vertical and planar shift that put a planar pose (3,) on another."""
    turn = truth[2] - estimate[2]
    c, s = math.cos(turn), math.sin(turn)
    moved = np.eye(4)
    moved[:2, :2] = (c, -s), (s, c)
    moved[:2, 3] = truth[:2] - moved[:2, :2] @ estimate[:2]
    return moved


@dataclass(frozen=True, slots=True, eq=False)
class TrackErrors:
    """Of a trajectory against the truth, at the pings.

    Attributes:
        rms_m, max_m: of the position.
        rms_deg: of the attitude.
        covered: share of the pings that the trajectory has a pose for.
        anchor: (4, 4) truth from the trajectory's frame.
    """

    rms_m: float
    max_m: float
    rms_deg: float
    covered: float
    anchor: Floats


SLACK_S = 0.02
"""A trajectory of mapped pings may begin and end so much off the times of their transmission."""


def track_errors(estimate: PoseTrack, truth: PoseTrack, ping_times_s: Floats) -> TrackErrors:
    """Compare an estimate with the truth, anchored at the first ping that it has.

    Args:
        estimate: in any frame whose z is up.
        truth: covers all pings.
        ping_times_s: (N,) Unix time.

    Raises:
        ValueError: it covers no ping.
    """
    first_s, last_s = estimate.time_s[0] - SLACK_S, estimate.time_s[-1] + SLACK_S
    inside = (ping_times_s >= first_s) & (ping_times_s <= last_s)
    if not inside.any():
        raise ValueError("the trajectory covers no ping")
    times_s = np.clip(ping_times_s[inside], estimate.time_s[0], estimate.time_s[-1])
    found, true = estimate.at(times_s), truth.at(times_s)
    moved = anchor(found.planar()[0], true.planar()[0])
    placed = found.evo()
    placed.transform(moved)
    errors = {}
    for relation in (PoseRelation.translation_part, PoseRelation.rotation_angle_deg):
        errors[relation] = APE(relation)
        errors[relation].process_data((true.evo(), placed))
    place, turn = (errors[relation].get_all_statistics() for relation in errors)
    rms, most = StatisticsType.rmse.value, StatisticsType.max.value
    return TrackErrors(
        float(place[rms]), float(place[most]), float(turn[rms]), float(inside.mean()), moved
    )


@dataclass(frozen=True, slots=True)
class LoopErrors:
    """Of the accepted loops against the truth.

    Attributes:
        count: how many there are.
        wrong: off by more than `WRONG_M` or `WRONG_DEG`.
        worst_m, worst_deg: the largest errors in place and heading; 0 without loops.
        median_m: of place; 0 without loops.
    """

    count: int
    wrong: int
    worst_m: float
    worst_deg: float
    median_m: float


def read_loops(path: Path) -> Floats:
    """Read the accepted loops of a CSV file.

    Its columns are `t_i_s` and `t_j_s`, Unix time of two nodes, and `x_m`, `y_m`, `yaw_rad`, the
    base at the second in the levelled base frame of the first. Where a column `accepted` says 0,
    a loop does not count.

    Returns:
        (L, 5) in that order.
    """
    names = ("t_i_s", "t_j_s", "x_m", "y_m", "yaw_rad")
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row.get("accepted", "1") != "0"]
    return np.array([[float(row[name]) for name in names] for row in rows]).reshape(-1, len(names))


def loop_errors(loops: Floats, truth: PoseTrack) -> LoopErrors:
    """Compare loops (L, 5), as of `read_loops`, with the truth."""
    if len(loops) == 0:
        return LoopErrors(0, 0, 0.0, 0.0, 0.0)
    begin, end = (truth.at(loops[:, k]).planar() for k in (0, 1))
    c, s = np.cos(begin[:, 2]), np.sin(begin[:, 2])
    dx, dy = (end - begin)[:, :2].T
    true = np.column_stack([c * dx + s * dy, c * dy - s * dx])
    off_m = np.hypot(*(loops[:, 2:4] - true).T)
    turn = loops[:, 4] - (end - begin)[:, 2]
    off_deg = np.abs(np.degrees(np.angle(np.exp(1j * turn))))
    return LoopErrors(
        len(loops),
        int(((off_m > WRONG_M) | (off_deg > WRONG_DEG)).sum()),
        float(off_m.max()),
        float(off_deg.max()),
        float(np.median(off_m)),
    )


@dataclass(frozen=True, slots=True)
class MapErrors:
    """Distances of a map's occupied voxels to the surface that the sonar had in sight.

    The surface is given as one point a cell of 5 cm, which makes distances up to some 3 cm too
    large.

    Attributes:
        voxels: occupied.
        median_m, p95_m: distances of their centres; 0 without voxels.
        pings: that were mapped.
    """

    voxels: int
    median_m: float
    p95_m: float
    pings: int


def mapped_voxels(recording: Path, odometry: Path | None, config: Config) -> tuple[Floats, int]:
    """Map a recording in memory, as `mapperd --replay` does.

    Args:
        recording: of the sonar.
        odometry: a file that replaces the recorded odometry.
        config: the settings.

    Returns:
        (N, 3) centres of the occupied voxels in the odometry's frame, and how many pings went in.
    """
    with open_recording(recording) as chunks:
        poses, merged = OdometryPoses(config), iter(chunks)
        if odometry is not None:
            files = read_odometry(OdometryOptions((odometry,)), config)
            poses = OdometryPoses(files.settings(config))
            merged = files.merge().into(chunks, is_last=True)
        sonar_map = SonarMap(config)
        replay = Replay(sonar_map, poses, Window(), time.process_time)
        pings = 0

        def count(_: object) -> None:
            nonlocal pings
            pings += 1

        replay.on_posed = count
        for _ in replay.run(merged):
            pass
    centres_m, log_odds, _ = sonar_map.core.voxels()
    return centres_m[log_odds >= config.occupied_threshold], pings


def map_errors(
    recording: Path, odometry: Path | None, config: Config, surface: Path, moved: Floats
) -> MapErrors:
    """Map a recording and compare it with the surface that the sonar had in sight.

    Args:
        recording: of the sonar.
        odometry: a file that replaces the recorded odometry.
        config: the settings.
        surface: file of its points.
        moved: (4, 4) truth from the odometry's frame.
    """
    centres_m, pings = mapped_voxels(recording, odometry, config)
    if len(centres_m) == 0:
        return MapErrors(0, 0.0, 0.0, pings)
    judged = centres_m
    if len(centres_m) > VOXELS_JUDGED:
        chosen = np.random.default_rng(0).choice(len(centres_m), VOXELS_JUDGED, replace=False)
        judged = centres_m[chosen]
    placed_m = judged @ moved[:3, :3].T + moved[:3, 3]
    distance_m, _ = _surface(surface).query(placed_m)
    median_m, p95_m = np.quantile(distance_m, (0.5, 0.95))
    return MapErrors(len(centres_m), float(median_m), float(p95_m), pings)


@cache
def _surface(path: Path) -> cKDTree:
    return cKDTree(np.load(path))
