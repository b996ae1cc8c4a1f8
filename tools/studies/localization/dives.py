"""How well simulated dives are localized: following, finding oneself, and being carried off.

    .venv/bin/python tools/studies/localization/dives.py --scenes harbour --runs 100 --out out/dives

Odometry errs by 2 % of the way and turns by a degree a minute; a current of 0.05 m/s turns the bow
off the way. The map is the scene's true surface in voxels, from a map file; scans are cast in the
scene with the errors that scans of simulated pings have, or with `--pings` taken out of such pings.
"""

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
import numpy as np
from numpy.typing import NDArray
from sonar_sim import FramePose, Simulator
from sonar_sim.geometry.pose import quaternion_of, rotation_of

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import ping_image_of_array
from mapperd.localization.extraction import ScanContext, scan_of
from mapperd.localization.maps import VolumeMap
from mapperd.localization.scan import Scan, level_T_base
from studies.localization.runs import FilterUpdate, LocalizationDive, dive, settings
from studies.localization.world import WORLDS, DiveWorld

__all__ = ["ping_scans"]


mpl.use("Agg")

MINUTE_S = 60.0
NEAR_M = 0.5
"""Above and below the vehicle's height: surfaces drawn as the map."""

COLUMNS = 3
"""Instants side by side."""


def draw_errors(path: Path, moments: list[FilterUpdate], title: str) -> None:
    """Place and heading of the best mode, against the odometry alone."""
    minutes = [m.time_s / 60.0 for m in moments]
    picture, (place, heading) = plt.subplots(2, 1, figsize=(9, 5), sharex=True)
    place.semilogy(minutes, [m.reckoned_m for m in moments], color="#9a9a9a", label="odometry")
    place.semilogy(minutes, [m.error_m for m in moments], color="#1f77b4", lw=0.7, label="filter")
    place.set_ylim(0.01, None)
    place.set_ylabel("error, m")
    place.set_title(title)
    place.legend(loc="lower right")
    turns = np.degrees([m.turn_error_rad for m in moments])
    heading.plot(minutes, turns, color="#1f77b4", lw=0.7)
    heading.set_ylabel("heading error, deg")
    heading.set_xlabel("minutes")
    picture.tight_layout()
    picture.savefig(path, dpi=90)
    plt.close(picture)


def draw_clouds(path: Path, known: VolumeMap, moments: list[FilterUpdate], title: str) -> None:
    """Particles on the map at some instants, the true place a cross."""
    shown = [m for m in moments if m.particles is not None]
    rows = -(-len(shown) // COLUMNS)
    picture, panels = plt.subplots(rows, COLUMNS, figsize=(9, 2.3 * rows), squeeze=False)
    first, edge_m = known.first_centre_m, known.resolution_m
    nearest = known.distances_m.min(axis=2).T
    high, wide = nearest.shape
    extent = (first[0], first[0] + wide * edge_m, first[1], first[1] + high * edge_m)
    wall = (known.distances_m < edge_m).sum(axis=2).T * edge_m > NEAR_M
    for panel in panels.flat[len(shown) :]:
        panel.set_axis_off()
    for panel, moment in zip(panels.flat, shown, strict=False):
        panel.imshow(wall, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=1.5)
        particles = moment.particles
        if particles is not None:
            panel.scatter(particles[:, 0], particles[:, 1], s=2, color="#d62728", lw=0)
        panel.plot(*moment.true[:2], "x", color="#1f77b4")
        panel.set(xlim=extent[:2], ylim=extent[2:])
        seconds, minutes = moment.time_s, moment.time_s / MINUTE_S
        at = f"{seconds:.0f} s" if seconds < MINUTE_S else f"{minutes:.0f} min"
        panel.set_title(f"{title}, {at}, {moment.way_m:.1f} m", fontsize=10)
    picture.tight_layout()
    picture.savefig(path, dpi=90)
    plt.close(picture)


Floats = NDArray[np.float64]


def ping_scans(world: DiveWorld, config: Config, seed: int) -> Callable[[int, Floats, int], Scan]:
    """What makes the scan of a ping's number, place (6,) and stamp; some 0.2 s of one core each."""
    sonar = world.scenario.sonar
    simulator = Simulator(world.scenario.scene, sonar, seed)
    sines = np.linspace(-1.0, 1.0, sonar.beams) * math.sin(sonar.half_aperture_rad)
    bearing = np.arcsin(sines)

    def scan(number: int, place: Floats, stamp_ns: int) -> Scan:
        pose = FramePose(place[:3], rotation_of(*place[3:]))
        ping = simulator.ping(pose, number)
        echo = replace(
            ping_image_of_array(ping.image, sonar.range_m, bearing, config.sonar),
            gamma_byte=sonar.gamma_byte,
        )
        around = ScanContext(
            stamp_ns,
            level_T_base(quaternion_of(pose.rotation)),
            height_m=float(place[2]) - world.place.floor_m,
            depth_m=-float(place[2]),
        )
        made = scan_of(echo, around, config)
        if isinstance(made, Reject):
            raise TypeError("nobody watches for bursts here")
        return made

    return scan


WITHIN_M = 150.0
"""Of track: by then a vehicle is to have found itself."""

LASTING_M = 25.0
"""An estimate that stays right so long is the right mode."""

TURN_RAD = 0.2
CARRIED_OFF_S = 60.0
INSTANTS = 5
FINDING_S = (0.0, 4.0, 7.0, 10.0, 30.0)
"""After a start anywhere: when its particles are drawn."""


class Followed(msgspec.Struct, frozen=True):
    """Of one dive from a known start; metres, degrees."""

    scene: str
    minutes: float
    way_m: float
    median_m: float
    p95_m: float
    max_m: float
    median_deg: float
    reckoned_m: float
    """Odometry alone at the end."""
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Relocalization:
    """Of one dive that begins anywhere, or from where the vehicle was carried off.

    Attributes:
        after_m: of track, from where on the estimate was right and sure; None within `WITHIN_M`.
        wrong_and_sure: updates before that reported a wrong place without calling it ambiguous.
        wrong: updates before that were wrong at all.
    """

    after_m: float | None
    wrong_and_sure: int
    wrong: int


def follow(
    world: DiveWorld, known: VolumeMap, minutes: float, seed: int, *, pings: bool = False
) -> tuple[Followed, list[FilterUpdate]]:
    """Dive from a start that is known."""
    config, duration_s = settings(world.place, seed), 60.0 * minutes
    began_s = time.process_time()
    instants = tuple(duration_s * k / INSTANTS for k in range(INSTANTS))
    scans = ping_scans(world, config, seed) if pings else None
    what = LocalizationDive(duration_s=duration_s, seed=seed)
    moments = list(dive(world, known, what, config, scans=scans, keep_particles_s=instants))
    errors = np.array([m.error_m for m in moments])
    turns = np.degrees([m.turn_error_rad for m in moments])
    median, p95, most = np.quantile(errors, (0.5, 0.95, 1.0))
    last = moments[-1]
    row = Followed(
        world.place.scene,
        minutes,
        round(last.way_m, 1),
        median_m=round(float(median), 3),
        p95_m=round(float(p95), 3),
        max_m=round(float(most), 3),
        median_deg=round(float(np.median(turns)), 3),
        reckoned_m=round(last.reckoned_m, 3),
        cpu_s=round(time.process_time() - began_s, 1),
    )
    return row, moments


def find(
    world: DiveWorld, known: VolumeMap, seed: int, *, carried_off: bool = False
) -> Relocalization:
    """Dive from anywhere, or be carried off, until the right mode lasts."""
    off_s = CARRIED_OFF_S if carried_off else None
    longest_s = 4.0 * WITHIN_M / (2.0 * world.place.speed_mps) + (off_s or 0.0)
    start = "known" if carried_off else "anywhere"
    what = LocalizationDive(start, longest_s, seed, off_s)
    moments = dive(world, known, what, settings(world.place, seed))
    return judged(moments, world.place.right_m, off_s or 0.0)


CERTAINTY_M, CERTAINTY_OFF_S = 50.0, 20.0
"""Of way that certainty is judged over (a fifth in the tank); a vehicle is carried off then."""


@dataclass(frozen=True, slots=True)
class Certainty:
    """How far the reports of dives that begin anywhere, or are carried off, can be trusted.

    Attributes:
        wrong, wrong_and_sure: updates at a wrong place, and those of them not ambiguous.
        right, right_and_sure: the others likewise.
        sure_after_m: of way until the first right and certain one; infinite without one.
    """

    wrong: int
    wrong_and_sure: int
    right: int
    right_and_sure: int
    sure_after_m: float


def certainty(
    world: DiveWorld, known: VolumeMap, seed: int, *, carried_off: bool = False
) -> Certainty:
    """Dive from anywhere, or be carried off, over a fixed way."""
    off_s = CERTAINTY_OFF_S if carried_off else None
    way_m = CERTAINTY_M * world.place.step_m / WORLDS["harbour"].step_m
    duration_s = way_m / world.place.speed_mps + (off_s or 0.0)
    what = LocalizationDive("known" if carried_off else "anywhere", duration_s, seed, off_s)
    moments = [
        moment
        for moment in dive(world, known, what, settings(world.place, seed))
        if moment.time_s >= (off_s or 0.0)
    ]
    right = np.array(
        [m.error_m < world.place.right_m and m.turn_error_rad < TURN_RAD for m in moments]
    )
    sure = np.array([not m.belief.ambiguous for m in moments])
    ways = [m.way_m - moments[0].way_m for m, one in zip(moments, right & sure, strict=True) if one]
    return Certainty(
        wrong=int((~right).sum()),
        wrong_and_sure=int((~right & sure).sum()),
        right=int(right.sum()),
        right_and_sure=int((right & sure).sum()),
        sure_after_m=min(ways, default=math.inf),
    )


def certainty_line(name: str, found: list[Certainty]) -> str:
    """One line."""
    wrong, bad = sum(one.wrong for one in found), sum(one.wrong_and_sure for one in found)
    right, good = sum(one.right for one in found), sum(one.right_and_sure for one in found)
    after_m = sorted(one.sure_after_m for one in found)[len(found) // 2]
    return (
        f"{name}: {bad} of {wrong} wrong and {good} of {right} right updates are certain; half of "
        f"the runs are right and certain after {after_m:.0f} m"
    )


def draw_finding(path: Path, world: DiveWorld, known: VolumeMap, seed: int) -> None:
    """Particles of a dive that begins anywhere."""
    what = LocalizationDive("anywhere", FINDING_S[-1] + 2.0, seed)
    config = settings(world.place, seed)
    moments = list(dive(world, known, what, config, keep_particles_s=FINDING_S))
    draw_clouds(path, known, moments, world.place.scene)


def judged(moments: Iterable[FilterUpdate], right_m: float, after_s: float = 0.0) -> Relocalization:
    """When the right mode was found, and the reports before."""
    begin_m, since_m, sure, wrong = None, None, 0, 0
    for moment in moments:
        if moment.time_s < after_s:
            continue
        begin_m = moment.way_m if begin_m is None else begin_m
        way_m = moment.way_m - begin_m
        right = moment.error_m < right_m and moment.turn_error_rad < TURN_RAD
        wrong += not right
        sure += not right and not moment.belief.ambiguous
        if not right or moment.belief.ambiguous:
            since_m = None
        elif since_m is None:
            since_m = way_m
        if since_m is None and way_m > WITHIN_M:
            break
        if since_m is not None and way_m - since_m > LASTING_M:
            break
    return Relocalization(since_m, sure, wrong)


def finding_line(name: str, found: list[Relocalization]) -> str:
    """One line."""
    after_m = sorted(one.after_m for one in found if one.after_m is not None)
    wrong, sure = sum(one.wrong for one in found), sum(one.wrong_and_sure for one in found)
    middle = f"{after_m[len(after_m) // 2]:.0f} m" if after_m else "never"
    share = sure / wrong if wrong else 0.0
    return (
        f"{name}: {len(after_m)} of {len(found)} within {WITHIN_M:g} m of track, half of them "
        f"after {middle}; of {wrong} wrong updates {share:.0%} did not call themselves ambiguous"
    )


def main() -> int:
    """Dive, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenes", nargs="*", default=list(WORLDS), choices=list(WORLDS))
    parser.add_argument("--minutes", type=float, default=30.0, help="of following; 0 for none")
    parser.add_argument("--runs", type=int, default=0, help="that begin anywhere")
    parser.add_argument("--carried-off", type=int, default=0, help="runs")
    parser.add_argument("--certainty", type=int, default=0, help="runs of each of both kinds")
    parser.add_argument("--seed", type=int, default=1, help="of the first run")
    parser.add_argument("--pings", action="store_true", help="follow with scans of simulated pings")
    parser.add_argument("--out", type=Path, default=Path("out/dives"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for scene in args.scenes:
        world = DiveWorld(WORLDS[scene])
        known = world.known(20 * world.place.voxel_m)
        if args.minutes > 0:
            row, moments = follow(world, known, args.minutes, args.seed, pings=args.pings)
            print(msgspec.json.encode(row).decode(), flush=True)
            draw_errors(args.out / f"{scene}-error.png", moments, scene)
            draw_clouds(args.out / f"{scene}-particles.png", known, moments, scene)
        seeds = range(args.seed, args.seed + args.runs)
        if seeds:
            draw_finding(args.out / f"{scene}-finding.png", world, known, args.seed)
            print(
                finding_line(f"{scene}, anywhere", [find(world, known, k) for k in seeds]),
                flush=True,
            )
        seeds = range(args.seed, args.seed + args.carried_off)
        if seeds:
            found = [find(world, known, k, carried_off=True) for k in seeds]
            print(finding_line(f"{scene}, carried off", found), flush=True)
        seeds = range(args.seed, args.seed + args.certainty)
        for off in (False, True) if seeds else ():
            claims = [certainty(world, known, k, carried_off=off) for k in seeds]
            name = f"{scene}, {'carried off' if off else 'anywhere'}"
            print(certainty_line(name, claims), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
