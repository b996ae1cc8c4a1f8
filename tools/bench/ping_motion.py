"""What motion within the ping gains; prints the table of docs/reports/mapping.md.

Posts are seen by a sonar that moves and turns while it listens. Each of their points is found in
the image by going to and fro between its range and the sonar's pose at that time; the map then
gets the pose at the middle of the image, which is true. How far the occupied voxels' centres lie
from the posts is compared with a sonar that stops for every ping. The fan is thin, so that the
elevation that a sonar cannot measure does not hide the rest. What motion costs is measured by
`make bench`.

Usage: python -m bench ping-motion [--pings N]
"""

import argparse
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config, MappingConfig, OctreeConfig, SonarConfig
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap

Floats = NDArray[np.float64]

SOUND_MPS = 1500.0
RANGE_M, ROWS, BEAMS = 30.0, 500, 512
HALF_FAN_RAD = math.radians(65)
PERIOD_S = 0.1
POST_RADIUS_M = 0.15
POSTS = 60
RESOLUTION_M = 0.05
THIN_DEG = 1.0
SEED = 11
MOTIONS = ((1.0, 0.0), (0.0, 5.0), (0.0, 20.0), (1.0, 20.0), (3.0, 45.0))
"""Metres per second, half ahead and half to the side, and degrees per second of yaw."""


@dataclass(frozen=True, slots=True)
class MovingSonar:
    """A sonar in the plane of its fan; it looks along x at the middle of the run.

    Attributes:
        speed_mps: in the direction of 45 degrees to port, in the map.
        rate_radps: to port.
        pings: of them the one in the middle is at the origin.
    """

    speed_mps: float
    rate_radps: float
    pings: int

    @property
    def velocity_mps(self) -> Floats:
        """(3,), map frame."""
        return self.speed_mps * np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0])

    def sent_s(self, i: int) -> float:
        """When ping i leaves."""
        return PERIOD_S * (i - (self.pings - 1) / 2)

    def position_m(self, time_s: Floats | float) -> Floats:
        """(..., 3)."""
        return np.multiply.outer(time_s, self.velocity_mps)

    def pose(self, time_s: float) -> Floats:
        """(4, 4) map_T_sonar."""
        yaw = self.rate_radps * time_s
        pose = np.eye(4)
        pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        pose[:3, 3] = self.position_m(time_s)
        return pose


def posts() -> Floats:
    """Axes of upright posts, (POSTS, 2), all around where the sonar looks."""
    rng = np.random.default_rng(SEED)
    ranges_m = np.sqrt(rng.uniform(5.0**2, 28.0**2, POSTS))
    bearings = rng.uniform(-HALF_FAN_RAD, HALF_FAN_RAD, POSTS)
    return np.column_stack([ranges_m * np.cos(bearings), ranges_m * np.sin(bearings)])


def heard(
    run: MovingSonar, sent_s: float, points_m: Floats, *, stops: bool
) -> tuple[Floats, Floats]:
    """Range and sine of the bearing (positive to starboard) of points (N, 3)."""
    out_m = np.linalg.norm(points_m - run.position_m(sent_s), axis=1)
    range_m = out_m
    back_s = np.full(len(points_m), sent_s)
    for _ in range(0 if stops else 12):
        back_s = sent_s + 2 * range_m / SOUND_MPS
        range_m = (out_m + np.linalg.norm(points_m - run.position_m(back_s), axis=1)) / 2
    towards = points_m - run.position_m(back_s)
    yaw = np.arctan2(towards[:, 1], towards[:, 0]) - run.rate_radps * back_s
    return range_m, np.where(np.cos(yaw) > 0, -np.sin(yaw), np.inf)


def echo(run: MovingSonar, sent_s: float, axes_m: Floats, *, stops: bool) -> PingImage:
    """What the sonar hears of the posts' near sides."""
    around = np.linspace(0, 2 * math.pi, 600, endpoint=False)
    normals = np.column_stack([np.cos(around), np.sin(around)])
    flat = axes_m[:, None, :] + POST_RADIUS_M * normals
    faces = ((run.position_m(sent_s)[:2] - flat) * normals).sum(axis=2) > 0
    points_m = np.column_stack([flat[faces], np.zeros(np.count_nonzero(faces))])
    range_m, sine = heard(run, sent_s, points_m, stops=stops)
    step = 2 * math.sin(HALF_FAN_RAD) / (BEAMS - 1)
    row = np.floor(range_m / (RANGE_M / ROWS)).astype(int)
    beam = np.floor(np.minimum(sine, 2.0) / step + BEAMS / 2).astype(int)
    seen = (row < ROWS) & (beam >= 0) & (beam < BEAMS)
    intensity = np.zeros((ROWS, BEAMS), dtype=np.float32)
    intensity[row[seen], beam[seen]] = 200.0
    bearings = np.arcsin(step * (np.arange(BEAMS) - (BEAMS - 1) / 2))
    return PingImage(intensity, bearings, RANGE_M / ROWS)


def errors_m(run: MovingSonar, *, stops: bool, corrected: bool) -> Floats:
    """How far each occupied voxel's centre lies from the nearest post's surface."""
    axes_m = posts()
    config = Config(
        sonar=SonarConfig(vertical_aperture=THIN_DEG),
        octree=OctreeConfig(voxel_resolution=RESOLUTION_M),
        mapping=MappingConfig(within_ping_motion=corrected),
    )
    sonar_map = SonarMap(config)
    middle_s = 0.0 if stops else RANGE_M / 2 / SOUND_MPS
    motion = PingMotion(run.velocity_mps, np.array([0.0, 0.0, run.rate_radps]), middle_s, SOUND_MPS)
    for i in range(run.pings):
        sent_s = run.sent_s(i)
        image = echo(run, sent_s, axes_m, stops=stops)
        sonar_map.integrate(image, run.pose(sent_s + middle_s), motion if corrected else None)
    centres_m = sonar_map.voxels("occupied").centres_m[:, :2]
    distance_m = np.full(len(centres_m), np.inf)
    for axis_m in axes_m:
        off_m = np.abs(np.linalg.norm(centres_m - axis_m, axis=1) - POST_RADIUS_M)
        distance_m = np.minimum(distance_m, off_m)
    return distance_m


def gain_table(pings: int) -> str:
    """Markdown."""
    lines = [
        "| m/s | °/s | stops for each ping | with | without | 95 %: stops | with | without |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for speed_mps, rate_dps in MOTIONS:
        run = MovingSonar(speed_mps, math.radians(rate_dps), pings)
        found = [
            errors_m(run, stops=stops, corrected=corrected)
            for stops, corrected in ((True, False), (False, True), (False, False))
        ]
        cells = [f"{1e3 * np.quantile(error, q):.0f} mm" for q in (0.5, 0.95) for error in found]
        lines.append(f"| {speed_mps:g} | {rate_dps:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pings", type=int, default=12)
    print(gain_table(parser.parse_args().pings))


if __name__ == "__main__":
    main()
