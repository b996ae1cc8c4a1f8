"""What poses cost the map: surfaces of a moving dive, with true poses and with those of odometry.

The dive is that of moving_dive.py: 1 m/s, 20 degrees a second, arrivals of records and pings late
by up to 30 ms, clocks that drift by 30 ppm. Everything goes the way of live data: bytes, decoder,
clock fit, fusion, pairing, step, map. Prints the table; --write puts it into
docs/guides/odometry.md.

Usage: python -m studies pose-error [--write]
"""

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.pose_lookup import OdometryPoses, ping_time_ns
from mapperd.pipeline.step import StepRunner
from oculus_driver.clock import SonarClock
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import StreamParser
from studies.moving_dive import SOUND_MPS, START_NS, Dive
from studies.report import PAGES, write_section

TARGET = 1.2


def pings_of(dive: Dive, data: bytes, arrival_ns: int) -> Ping:
    """A ping of its message."""
    (message,) = StreamParser().feed(data, arrival_ns)
    ping = decode_ping(message)
    if not isinstance(ping, Ping):
        raise TypeError(f"{dive}: {ping}")
    return ping


def by_truth(dive: Dive, config: Config) -> SonarMap:
    """Perfect poses and motion."""
    sonar_map = SonarMap(config)
    stepping = StepRunner(sonar_map, lambda: 0.0)
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
        stepping.step(pings_of(dive, dive.ping(i), START_NS), pose)
    return sonar_map


def by_odometry(dive: Dive, config: Config, *, stamped: bool = True) -> SonarMap:
    """Poses of the odometry, as live.

    Raises:
        ValueError: a ping was dropped, so the rows would not compare.
    """
    sonar_map = SonarMap(config)
    poses = OdometryPoses(config)
    stepping = StepRunner(sonar_map, lambda: 0.0)
    clock = SonarClock()
    for arrival_ns, what in dive.arrivals(stamped=stamped):
        if isinstance(what, bytes):
            poses.add_odometry("odometry", what, arrival_ns)
        else:
            ping = pings_of(dive, dive.ping(what), arrival_ns)
            poses.add_ping(ping, ping_time_ns(ping, clock))
        for ping, pose in poses.resolved(arrival_ns):
            stepping.step(ping, pose)
    for ping, pose in poses.resolved(None, final=True):
        stepping.step(ping, pose)
    counters = stepping.counters
    if counters.pings_dropped:
        raise ValueError(f"dropped: {dict(counters.pings_dropped)}, {counters.first_drop}")
    return sonar_map


def rows(dive: Dive) -> dict[str, NDArray[np.float64]]:
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
    said = parser.parse_args()
    text = table(rows(Dive()))
    print(text)
    if said.write:
        write_section(PAGES["odometry"], "pose error", text, "python -m studies pose-error")


if __name__ == "__main__":
    main()
