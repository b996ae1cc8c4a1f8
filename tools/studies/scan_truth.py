"""How true the scans are that are taken out of simulated pings, and pictures of them.

    .venv/bin/python tools/studies/scan_truth.py --pings 24 --out out/scans

A return is true if it lies within one resolution cell of a first surface: within one row of what a
ray meets first, among the rays within a beam's width to either side and the vertical aperture.
"""

import argparse
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim import FramePose, Scenario, SimulatedPing, Simulator, SonarSettings, load_scenario
from sonar_sim.geometry.pose import quaternion_of, rotation_of
from sonar_sim.propagation.ground_truth import Truth

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import PingImage, ping_image_of_array
from mapperd.localization.extraction import ScanContext, floor_gate_m, scan_of
from mapperd.localization.scan import Scan, level_T_base
from studies.scan_picture import draw_scan, write_picture

Floats = NDArray[np.float64]

STEPS = 16
"""Directions within a beam's width to either side, of which each has its first surface."""

BESIDE, STEEP = 3.0, 1.8
"""In beam widths to either side, and in apertures: an echo at 1.8 loses 24 dB on its two ways."""

PICTURES = 3
"""Of each place."""


@dataclass(frozen=True, slots=True)
class PoseBox:
    """Poses drawn at random in a box of a scene's water, and how the sonar looks from there."""

    scene: str
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    range_m: float
    beam_width_deg: float
    floor_m: float
    """Height of the floor, where it is level."""


PLACES = (
    PoseBox("harbour", (-20.0, -8.0, -3.2), (20.0, -3.0, -1.8), 20.0, 1.0, -6.5),
    PoseBox("tank", (-0.8, -0.8, -1.5), (0.8, 0.2, -0.9), 4.0, 0.6, -2.4),
)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedScan:
    """One simulated ping, and what is taken out of it.

    Attributes:
        image: the image.
        scan: what is taken out.
        true: (N,) bool, returns that lie on a first surface.
        beside: (N,) bool, others that lie on one within `BESIDE` beam widths.
        steep: (N,) bool, others that lie on one above or below the aperture, within `STEEP` of it.
        sure: (N,) bool, returns from nearer than floor and surface.
        seen: beams that look at a first surface before floor and surface.
        cpu_s: that the scan took.
    """

    image: PingImage
    scan: Scan
    true: NDArray[np.bool_]
    beside: NDArray[np.bool_]
    steep: NDArray[np.bool_]
    sure: NDArray[np.bool_]
    seen: int
    cpu_s: float


def look(
    place: PoseBox, pings: int, seed: int = 1, config: Config | None = None
) -> list[JudgedScan]:
    """Simulate pings at random poses, and take scans out of them.

    Args:
        place: where.
        pings: how many.
        seed: of poses, speckle and noise.
        config: the settings; None has the defaults.
    """
    scenario = _scenario(place)
    simulator = Simulator(scenario.scene, scenario.sonar, seed)
    random = np.random.default_rng(seed)
    found = []
    for k in range(pings):
        position = random.uniform(place.low_m, place.high_m)
        angles = (*random.uniform(-3.0, 3.0, 2), random.uniform(0.0, 360.0))
        pose = FramePose(position, rotation_of(*np.radians(angles)))
        ping = simulator.ping(pose, k, truth=True)
        found.append(_look(place, scenario.sonar, pose, ping, config or Config()))
    return found


def first_surfaces_m(truth: Truth, bearing_rad: Floats, beam_width_rad: float) -> Floats:
    """(beams, STEPS) ranges of the first surfaces that each beam looks at; inf without one.

    Args:
        truth: rays within the vertical aperture.
        bearing_rad: (beams,).
        beam_width_rad: full, -3 dB.
    """
    direction = truth.ray_direction.astype(np.float64)
    ray_bearing = np.arctan2(-direction[:, 1], direction[:, 0])
    step_rad = 2 * beam_width_rad / STEPS
    offsets = (np.arange(STEPS) - (STEPS - 1) / 2) * step_rad
    order = np.argsort(ray_bearing)
    ranges = np.append(truth.ray_range_m[order].astype(np.float64), np.inf)
    middles = (bearing_rad[:, None] + offsets).ravel()
    low = np.searchsorted(ray_bearing[order], middles - step_rad / 2)
    high = np.searchsorted(ray_bearing[order], middles + step_rad / 2)
    pairs = np.stack([low, high], axis=1).ravel()
    first = np.minimum.reduceat(ranges, pairs)[::2]
    first[low == high] = np.inf
    return first.reshape(len(bearing_rad), STEPS)


def _look(
    place: PoseBox, sonar: SonarSettings, pose: FramePose, ping: SimulatedPing, config: Config
) -> JudgedScan:
    sines = np.linspace(-1.0, 1.0, sonar.beams) * math.sin(sonar.half_aperture_rad)
    image = replace(
        ping_image_of_array(ping.image, sonar.range_m, np.arcsin(sines), config.sonar),
        gamma_byte=sonar.gamma_byte,
    )
    around = ScanContext(
        0,
        level_T_base(quaternion_of(pose.rotation)),
        height_m=float(pose.position_m[2]) - place.floor_m,
        depth_m=-float(pose.position_m[2]),
    )
    began_s = time.process_time()
    scan = scan_of(image, around, config)
    cpu_s = time.process_time() - began_s
    if ping.truth is None or isinstance(scan, Reject):
        raise RuntimeError("a single ping with its truth gives a scan")
    half_rad, width_rad = sonar.vertical_width_rad / 2, math.radians(place.beam_width_deg)
    looks = ((half_rad, width_rad), (half_rad, BESIDE * width_rad), (STEEP * half_rad, width_rad))
    surfaces, *others = (
        first_surfaces_m(_within(ping.truth, half), image.bearings_rad, width)
        for half, width in looks
    )
    true, beside, steep = (
        np.abs(found[scan.beam] - scan.range_m[:, None]).min(axis=1) <= image.range_resolution_m
        for found in (surfaces, *others)
    )
    gate = floor_gate_m(
        image.bearings_rad,
        around.level_T_sonar,
        sonar.vertical_width_rad,
        height_m=around.height_m,
        depth_m=around.depth_m,
    )
    ahead = surfaces[:, STEPS // 2] < np.minimum(gate, image.max_range_m)
    sure, beside = scan.range_m < gate[scan.beam], beside & ~true
    steep = steep & ~true & ~beside
    return JudgedScan(image, scan, true, beside, steep, sure, int(ahead.sum()), cpu_s)


def _within(truth: Truth, half_aperture_rad: float) -> Truth:
    inside = np.abs(truth.ray_elevation_rad) <= half_aperture_rad
    direction, range_m = truth.ray_direction[inside], truth.ray_range_m[inside]
    return replace(truth, ray_direction=direction, ray_range_m=range_m)


def _scenario(place: PoseBox) -> Scenario:
    scenario = load_scenario(place.scene)
    sonar = replace(scenario.sonar, demanded_range_m=place.range_m)
    return replace(scenario, sonar=sonar)


def report(place: PoseBox, looks: list[JudgedScan]) -> str:
    """One line of figures."""
    true, beside, steep, sure = (
        np.concatenate([getattr(one, name) for one in looks])
        for name in ("true", "beside", "steep", "sure")
    )
    seen = sum(one.seen for one in looks)
    cpu_ms = 1e3 * float(np.median([one.cpu_s for one in looks]))
    return (
        f"{place.scene}: {len(looks)} pings, {len(true)} returns, {true.mean():.1%} true; nearer "
        f"than floor and surface {sure.sum()} returns, {true[sure].mean():.1%} true, "
        f"{beside[sure].mean():.1%} beside, {steep[sure].mean():.1%} above or below, where {seen} "
        f"beams look at something; {cpu_ms:.1f} ms a ping"
    )


def main() -> None:
    """Print the figures of all places, and draw each one's first pings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=24, help="at each place")
    parser.add_argument("--out", type=Path, help="folder for pictures")
    asked = parser.parse_args()
    for place in PLACES:
        looks = look(place, asked.pings)
        print(report(place, looks))
        for k, one in enumerate(looks[:PICTURES] if asked.out else []):
            picture = draw_scan(one.image, one.scan, one.true)
            write_picture(asked.out / f"scan-{place.scene}-{k}.png", picture)


if __name__ == "__main__":
    main()
