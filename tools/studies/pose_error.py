"""What poses cost the map: surfaces of a moving dive, with true poses and with those of odometry.

The dive is that of moving_dive.py: 1 m/s, 20 degrees a second, arrivals of records and pings late
by up to 30 ms, clocks that drift by 30 ppm. Everything goes the way of live data: bytes, decoder,
clock fit, fusion, pairing, step, map. Prints the table; --write puts it into
docs/reports/odometry.md.

Usage: python -m studies pose-error [--write]
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import (
    Config,
    MappingConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
    SonarConfig,
    TimeSyncConfig,
)
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.native import NativeRecord, encode_native
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import OdometryPoses, ping_time_ns
from oculus_driver.clock import SonarClock
from oculus_driver.encode import encode_ping
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import StreamParser
from studies.report import PAGES, write_section

Floats = NDArray[np.float64]

SOUND_MPS = 1500.0
HALF_FAN_RAD = math.radians(65)
POST_RADIUS_M = 0.15
START_NS = 1_700_000_000 * 10**9
AGREES_M = 1e-6


@dataclass(frozen=True)
class CircularDive:
    """A circle at constant speed and rate.

    Attributes:
        speed_mps, rate_dps: of the vehicle, to port.
        range_m: of the sonar.
        seconds: how long; pings and records are spread over it.
        ping_hz, record_hz: how many.
        jitter_s: arrivals are late by up to this, each by chance.
        stamp_jitter_s: the records' own stamps are off by up to half of this to either side.
        drift: the vehicle's clock gains on the host's by it, the sonar's loses as much.
        posts: how many.
        seed: of all chance.
    """

    speed_mps: float = 1.0
    rate_dps: float = 20.0
    range_m: float = 30.0
    seconds: float = 20.0
    ping_hz: float = 2.5
    record_hz: float = 50.0
    jitter_s: float = 0.03
    stamp_jitter_s: float = 0.0
    drift: float = 30e-6
    posts: int = 60
    rows: int = 500
    beams: int = 512
    voxel_m: float = 0.05
    seed: int = 11
    images: dict[int, NDArray[np.uint8]] = field(default_factory=dict)

    @property
    def rate_radps(self) -> float:
        """To port."""
        return math.radians(self.rate_dps)

    @property
    def flight_s(self) -> float:
        """To the end of the image and back."""
        return 2 * self.range_m / SOUND_MPS

    def config(self, policy: str = "interpolate", *, motion: bool = True) -> Config:
        """Settings; the fan is thin: the unknown elevation of echoes would hide the rest.

        The sonar sits off the middle of the vehicle and looks aside.
        """
        return Config(
            octree=OctreeConfig(voxel_resolution=self.voxel_m),
            sonar=SonarConfig(vertical_aperture=1.0),
            mapping=MappingConfig(within_ping_motion=motion),
            mounting=MountingConfig(
                position=PositionConfig(x=0.5, y=0.2, z=0.0),
                orientation=OrientationConfig(pitch=0.0, yaw=30.0),
            ),
            time_sync=TimeSyncConfig(policy=policy),  # type: ignore[arg-type]
        )

    def base_at(self, t_s: float) -> Pose:
        """The truth."""
        turned, radius_m = self.rate_radps * t_s, self.speed_mps / self.rate_radps
        place = (radius_m * math.sin(turned), radius_m * (1 - math.cos(turned)), 0.0)
        return pose_from_rpy(place, (0.0, 0.0, math.degrees(turned)))

    def velocity_mps(self, t_s: float) -> Floats:
        """Map axes."""
        turned = self.rate_radps * t_s
        return self.speed_mps * np.array([math.cos(turned), math.sin(turned), 0.0])

    @property
    def sent_s(self) -> Floats:
        """When the pings leave; neither first nor last at an end of the odometry."""
        return np.arange(0.5, self.seconds - 0.5, 1 / self.ping_hz)

    @cached_property
    def axes_m(self) -> Floats:
        """Of the posts, (posts, 2), around the circle and out of its way."""
        rng = np.random.default_rng(self.seed)
        nearest_m = 2 * self.speed_mps / self.rate_radps + 2.0
        ranges_m = np.sqrt(rng.uniform(nearest_m**2, (self.range_m - 2.0) ** 2, self.posts))
        bearings = rng.uniform(0, 2 * math.pi, self.posts)
        middle = np.array([0.0, self.speed_mps / self.rate_radps])
        around = np.column_stack([ranges_m * np.cos(bearings), ranges_m * np.sin(bearings)])
        return np.asarray(middle + around)

    @cached_property
    def base_T_sonar(self) -> Floats:  # noqa: N802 frames are named
        """(4, 4)."""
        return SonarMap(self.config()).base_T_sonar

    def ping(self, i: int) -> bytes:
        """The message of ping i, stamped by the sonar's own clock."""
        if i not in self.images:
            self.images[i] = self._image(float(self.sent_s[i]))
        degrees = np.degrees(np.arcsin(self._sines()))
        return encode_ping(
            ping_id=i + 1,
            mode=1,
            frequency_hz=750e3,
            range_m=self.range_m,
            gain_percent=50.0,
            speed_of_sound_mps=SOUND_MPS,
            salinity_ppt=35.0,
            start_time=77.0 + float(self.sent_s[i]) * (1 - self.drift),
            range_resolution_m=self.range_m / self.rows,
            bearings_cdeg=np.rint(100 * degrees).astype(np.int16),
            image=self.images[i],
            source_id=7,
        )

    def arrivals(self, *, stamped: bool = True) -> Iterator[tuple[int, int | bytes]]:
        """In order: arrival and number of a ping, or arrival and bytes of a record.

        Args:
            stamped: the records hold the time when they were true, on the vehicle's clock.
        """
        rng = np.random.default_rng(self.seed)
        events: list[tuple[int, int | bytes]] = []
        last_s = 0.0
        for t_s in np.arange(0.0, self.seconds, 1 / self.record_hz).tolist():
            last_s = max(last_s, t_s + 0.0005 + rng.uniform(0, self.jitter_s))  # a link keeps order
            off_s = self.stamp_jitter_s * rng.uniform(-0.5, 0.5)
            events.append((_host_ns(last_s), self._record(t_s, t_s + off_s, stamped=stamped)))
        for i, t_s in enumerate(self.sent_s.tolist()):
            late_s = 0.0005 + rng.uniform(0, self.jitter_s)
            events.append((_host_ns(t_s + self.flight_s + late_s), i))
        yield from sorted(events, key=lambda event: event[0])

    def errors_m(self, sonar_map: SonarMap) -> Floats:
        """How far each occupied voxel's centre lies from the nearest post's surface."""
        centres_m = sonar_map.voxels("occupied").centres_m[:, :2]
        nearest = np.full(len(centres_m), np.inf)
        for axis_m in self.axes_m:
            off_m = np.abs(np.linalg.norm(centres_m - axis_m, axis=1) - POST_RADIUS_M)
            nearest = np.minimum(nearest, off_m)
        return nearest

    def _record(self, t_s: float, stated_s: float, *, stamped: bool) -> bytes:
        pose = self.base_at(t_s)
        stamp_ns = round((4321.0 + stated_s * (1 + self.drift)) * 1e9)
        return encode_native(
            NativeRecord(
                v=1,
                clk="boot" if stamped else "arrival",
                t=stamp_ns if stamped else None,
                w="enu",
                b="flu",
                p=tuple(pose.position_m.tolist()),
                q=tuple(pose.map_q_base.tolist()),
            )
        )

    def _sines(self) -> Floats:
        steps: Floats = np.linspace(-1, 1, self.beams) * math.sin(HALF_FAN_RAD)
        return steps

    def _sonar_at(self, t_s: Floats | float) -> tuple[Floats, Floats]:
        """Positions (..., 2) and yaws (...,) of the sonar."""
        turned = self.rate_radps * np.asarray(t_s)
        radius_m = self.speed_mps / self.rate_radps
        c, s = np.cos(turned), np.sin(turned)
        x, y = self.base_T_sonar[:2, 3]
        place = np.stack([radius_m * s + c * x - s * y, radius_m * (1 - c) + s * x + c * y], -1)
        mounted = math.atan2(self.base_T_sonar[1, 0], self.base_T_sonar[0, 0])
        return place, turned + mounted

    def _image(self, sent_s: float) -> NDArray[np.uint8]:
        """What the sonar hears of the near sides of the posts."""
        around = np.linspace(0, 2 * math.pi, 600, endpoint=False)
        normals = np.column_stack([np.cos(around), np.sin(around)])
        flat = self.axes_m[:, None, :] + POST_RADIUS_M * normals
        sent_m, _ = self._sonar_at(sent_s)
        points_m = flat[((sent_m - flat) * normals).sum(axis=2) > 0]
        out_m = np.linalg.norm(points_m - sent_m, axis=1)
        range_m, before_m = out_m, np.full_like(out_m, np.inf)
        while np.abs(range_m - before_m).max() > AGREES_M:
            before_m = range_m
            place_m, yaw = self._sonar_at(sent_s + 2 * range_m / SOUND_MPS)
            range_m = (out_m + np.linalg.norm(points_m - place_m, axis=1)) / 2
        towards = points_m - place_m
        bearing = np.arctan2(towards[:, 1], towards[:, 0]) - yaw
        step = 2 * math.sin(HALF_FAN_RAD) / (self.beams - 1)
        row = np.floor(range_m / (self.range_m / self.rows)).astype(int)
        beam = np.rint(-np.sin(bearing) / step + (self.beams - 1) / 2).astype(int)
        seen = (row < self.rows) & (beam >= 0) & (beam < self.beams) & (np.cos(bearing) > 0)
        image = np.zeros((self.rows, self.beams), dtype=np.uint8)
        image[row[seen], beam[seen]] = 200
        return image


def _host_ns(t_s: float) -> int:
    return START_NS + round(t_s * 1e9)


TARGET = 1.2


def pings_of(dive: CircularDive, data: bytes, arrival_ns: int) -> Ping:
    """A ping of its message."""
    (message,) = StreamParser().feed(data, arrival_ns)
    ping = decode_ping(message)
    if not isinstance(ping, Ping):
        raise TypeError(f"{dive}: {ping}")
    return ping


def by_truth(dive: CircularDive, config: Config) -> SonarMap:
    """Perfect poses and motion."""
    sonar_map = SonarMap(config)
    executor = build_pipeline(sonar_map, OdometryPoses(config), remarks=None).executor
    for i, sent_s in enumerate(dive.sent_s.tolist()):
        middle_s = sent_s + dive.range_m / 2 / SOUND_MPS
        pose = FusedPose(
            dive.base_at(middle_s),
            dive.velocity_mps(middle_s),
            np.array([0.0, 0.0, dive.rate_radps]),
            np.zeros((6, 6)),
            0,
            0.0,
        )
        executor.map_ping(PosedPing(0, pings_of(dive, dive.ping(i), START_NS), pose, None))
    return sonar_map


def by_odometry(dive: CircularDive, config: Config, *, stamped: bool = True) -> SonarMap:
    """Poses of the odometry, as live.

    Raises:
        ValueError: a ping was dropped, so the rows would not compare.
    """
    sonar_map = SonarMap(config)
    poses = OdometryPoses(config)
    executor = build_pipeline(sonar_map, poses, remarks=None).executor
    clock = SonarClock()
    for arrival_ns, what in dive.arrivals(stamped=stamped):
        if isinstance(what, bytes):
            poses.add_odometry("odometry", what, arrival_ns)
        else:
            ping = pings_of(dive, dive.ping(what), arrival_ns)
            poses.add_ping(ping, ping_time_ns(ping, clock))
        for ping, pose in poses.resolved(arrival_ns):
            executor.map_ping(PosedPing(0, ping, pose, None))
    for ping, pose in poses.resolved(None, final=True):
        executor.map_ping(PosedPing(0, ping, pose, None))
    counters = executor.counters
    if counters.pings_dropped:
        raise ValueError(f"dropped: {dict(counters.pings_dropped)}, {counters.first_drop}")
    return sonar_map


def rows(dive: CircularDive) -> dict[str, NDArray[np.float64]]:
    """What was tried, to the errors of the occupied voxels, metres; true poses first."""
    plain = dive.config()
    stamps = replace(dive, stamp_jitter_s=dive.jitter_s, jitter_s=0.0)
    maps = {
        "true poses": by_truth(dive, plain),
        "interpolate": by_odometry(dive, plain),
        "interpolate, each ping placed as a whole": by_odometry(dive, dive.config(motion=False)),
        "true poses, each ping placed as a whole": by_truth(dive, dive.config(motion=False)),
        "nearest": by_odometry(dive, dive.config("nearest")),
        "latest": by_odometry(dive, dive.config("latest")),
        "interpolate, records without stamps": by_odometry(dive, plain, stamped=False),
        "interpolate, the stamps themselves off by ±15 ms": by_odometry(stamps, plain),
    }
    return {name: dive.errors_m(sonar_map) for name, sonar_map in maps.items()}


def rms(errors_m: NDArray[np.float64]) -> float:
    """Of the errors, metres."""
    return float(np.sqrt(np.mean(np.square(errors_m))))


def table(found: dict[str, NDArray[np.float64]]) -> str:
    """Markdown."""
    perfect = rms(next(iter(found.values())))
    lines = ["| poses | rms | to true poses | median | 95 % |", "|---|---:|---:|---:|---:|"]
    for name, errors in found.items():
        middle, most = 1e3 * np.quantile(errors, [0.5, 0.95])
        lines.append(
            f"| {name} | {1e3 * rms(errors):.0f} mm | {rms(errors) / perfect:.2f} | "
            f"{middle:.0f} mm | {most:.0f} mm |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="put the table into its page")
    args = parser.parse_args()
    text = table(rows(CircularDive()))
    print(text)
    if args.write:
        write_section(PAGES["odometry"], "pose error", text, "python -m studies pose-error")


if __name__ == "__main__":
    main()
