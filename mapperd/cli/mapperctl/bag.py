"""`mapperctl bag`: convert recordings and maps to ROS 2 bags, without ROS."""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from mapperd.cli.mapperctl.map_output import missing, remarks_on
from mapperd.cli.progress import ProgressBar
from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.export.rosbag import Bag, Storage, Turned, open_bag
from mapperd.geometry.frames import (
    Pose,
    quaternion_product,
    quaternion_to_matrix,
    rotation_from_rpy,
)
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.step import PingResult
from mapperd.session.recordings import RecordedSession, files_in, sessions_of
from mapperd.session.replay import Run, Window, as_asked, as_recorded, not_empty
from mapperd.store.map_files import map_in
from oculus_driver.errors import RecordingError

__all__ = ["bag_of_map", "bag_of_recordings"]


def bag_of_map(
    source: Path,
    path: Path,
    config: Config,
    values: Mapping[str, Any],
    *,
    storage: Storage,
    allow_damaged: bool = False,
) -> Iterator[str]:
    """Write a map file as a cloud and a grid, stamped with the file's modification time.

    Raises:
        MapperdError: the map, the settings or the bag are invalid.
    """
    found = map_in(source, config, values, allow_damaged=allow_damaged)
    stamp_ns = source.stat().st_mtime_ns
    with closing(found.map) as whole, open_bag(path, whole.config, storage) as bag:
        bag.cloud(stamp_ns, whole)
        bag.grid(stamp_ns, whole)
    yield from remarks_on(source, found)
    if found.bricks_lost:
        yield missing(found.bricks_lost)
    yield from _report(path, bag)


def bag_of_recordings(
    source: Path,
    path: Path,
    config: Config | None,
    values: Mapping[str, Any],
    *,
    pose: Pose | None = None,
    every_s: float = 0.0,
    storage: Storage = "mcap",
) -> Iterator[str]:
    """Write recordings as images, odometry, transforms and the map, through the pipeline.

    Args:
        source: a recording, or a folder of them.
        path: path of the bag.
        config: settings; None uses those of the recordings.
        values: settings that override `config`.
        pose: pose of a vehicle that did not move.
        every_s: period of the map's cloud; 0 writes it only at the end.
        storage: storage of the bag.

    Raises:
        MapperdError: the recordings, the settings or the bag are invalid.
        RecordingError: a recording cannot be read.
    """
    sessions = sessions_of(files_in([source], begun=True))
    if not sessions:
        raise RecordingError(f"{source}: no recording with anything in it")
    runs = [_run(session, config, values, pose) for session in not_empty(sessions)]
    sonar_map = SonarMap(runs[0].config)
    with open_bag(path, runs[0].config, storage) as bag:
        writer = _BagWriter(bag, sonar_map, round(every_s * 1e9))
        _mapped(runs, sonar_map, writer)
        writer.end()
    yield from _report(path, bag)
    for session in sessions:
        if damage := str(session.damaged):
            yield f"damaged: {damage}"
    if writer.unstamped:
        yield f"{writer.unstamped} pings without a time were left out"


def _run(
    session: RecordedSession, config: Config | None, values: Mapping[str, Any], pose: Pose | None
) -> Run:
    if config is None:
        return as_recorded(session)
    return as_asked(session, pose, with_values(config, values))


def _mapped(runs: Sequence[Run], sonar_map: SonarMap, writer: "_BagWriter") -> None:
    counters = PipelineCounters()
    size_bytes = sum(run.session.size_bytes for run in runs)
    bar = ProgressBar(sys.stderr, time.perf_counter)
    done_bytes = 0
    for run in runs:
        replay = run.replay(sonar_map, Window(), counters)
        replay.on_posed = writer.ping
        replay.pipeline.executor.on_ping = writer.placed
        for _ in replay.run(run.session):
            bar.show((done_bytes + run.session.bytes_read) / size_bytes, counters.pings_mapped)
        done_bytes += run.session.bytes_read
    bar.close(counters.pings_mapped)


def _report(path: Path, bag: Bag) -> Iterator[str]:
    size = sum(file.stat().st_size for file in path.iterdir())
    yield f"{path}: {size} bytes"
    for topic, count in sorted(bag.counts.items()):
        yield f"{topic}: {count} messages"


class _BagWriter:
    """Writes pings, poses and the map into a bag.

    Args:
        bag: the bag.
        sonar_map: the map.
        every_ns: period of the map's cloud; 0 writes it only at the end.

    Attributes:
        unstamped: number of pings without a time.
    """

    def __init__(self, bag: Bag, sonar_map: SonarMap, every_ns: int) -> None:
        self.unstamped = 0
        self._bag = bag
        self._map = sonar_map
        self._every_ns = every_ns
        self._newest_ns: int | None = None
        self._cloud_ns: int | None = None
        self._mounting: Pose | None = None

    def ping(self, posed: PosedPing) -> None:
        """Write the image of a ping, mapped or not."""
        if posed.t_ns is None:
            self.unstamped += 1
            return
        self._newest_ns = max(self._newest_ns or 0, posed.t_ns)
        self._bag.image(posed.t_ns, posed.ping.image)

    def placed(self, result: PingResult) -> None:
        """Write the pose by odometry, and in the map."""
        t_ns, odometry = result.posed.t_ns, result.posed.pose
        if t_ns is None:
            return
        self._write_mounting(t_ns)
        if isinstance(odometry, FusedPose):
            self._write_pose(t_ns, odometry, result)
        if self._every_ns:
            self._cloud_ns = t_ns if self._cloud_ns is None else self._cloud_ns
            if t_ns - self._cloud_ns >= self._every_ns:
                self._cloud_ns = t_ns
                self._bag.cloud(t_ns, self._map)

    def end(self) -> None:
        """Write the final map."""
        if self._newest_ns is not None:
            self._bag.cloud(self._newest_ns, self._map)
            self._bag.grid(self._newest_ns, self._map)

    def _write_pose(self, t_ns: int, odometry: FusedPose, result: PingResult) -> None:
        frames, odom = self._bag.config.frames, self._bag.config.amcl.odom_frame_id
        turned = [Turned(odom, frames.base, odometry.pose)]
        if isinstance(result.pose, FusedPose):
            shift = _map_of_odometry(result.pose.pose, odometry.pose)
            turned.append(Turned(frames.map, odom, shift))
        self._bag.odometry(t_ns, odometry)
        self._bag.transforms(t_ns, turned)

    def _write_mounting(self, t_ns: int) -> None:
        """Write the mounting, and again when it changes."""
        settings = self._map.config.mounting
        place, angles = settings.position, settings.orientation
        mounting = Pose(
            np.array([place.x, place.y, place.z]),
            rotation_from_rpy(angles.roll, angles.pitch, angles.yaw),
        )
        known = self._mounting
        if known is None or (known.map_T_base != mounting.map_T_base).any():
            self._mounting = mounting
            frames = self._bag.config.frames
            turned = [Turned(frames.base, frames.sonar, mounting)]
            self._bag.transforms(t_ns, turned, static=True)


def _map_of_odometry(in_map: Pose, in_odometry: Pose) -> Pose:
    """Transform from odometry to map frame, from the vehicle's pose in both."""
    back = in_odometry.map_q_base * (1, -1, -1, -1)
    turn = quaternion_product(in_map.map_q_base, back)
    turn /= np.linalg.norm(turn)
    shift_m = in_map.position_m - quaternion_to_matrix(turn) @ in_odometry.position_m
    return Pose(shift_m, turn)
