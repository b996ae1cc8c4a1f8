"""Whether a second pass over a place lands on the first when pings are mapped at corrected poses.

    .venv/bin/python tools/studies/localization/second_pass.py --out out/second-pass

Both passes are recordings of simulated pings with all effects that they call for. The first is
mapped where an odometry just set has it; the vehicle then drives about with its sonar silent. The
second pass is mapped twice by `mapperd --replay`: where the odometry, drifted by then, has it, and
where localization on the first pass's map has it.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from demo.ply_points import read_voxels
from demo.true_surface import TrueSurface
from numpy.typing import NDArray
from sonar_sim.sonar_motion import sonar_pose

from studies.localization.pass_dive import FIRST, SECOND, Pass, ping_poses, record
from studies.localization.pass_maps import Course, course, localized, mapped, plain
from studies.localization.pass_metric import Agreement, Fans, agreement, in_fans, to_nearest
from studies.localization.pass_pictures import Panel, draw
from studies.localization.world import HARBOUR, Place, World

__all__ = ["Study", "run"]

Floats = NDArray[np.float64]

PLACE = dataclasses.replace(HARBOUR, speed_mps=0.8)
FANS_S = 1.0
"""Between the pings whose fans say where a pass was looking."""
EXACT_WITHIN_M = 0.5
"""Of the comparison with the truth."""
MAPS = ("first", "corrected", "uncorrected")


class Compared(msgspec.Struct, frozen=True):
    """A map of the second pass with the first pass's, and with the scene."""

    to_first: Agreement
    from_first: Agreement
    truth_median_m: float
    truth_p95_m: float


class Found(msgspec.Struct, frozen=True):
    """What came out; metres, degrees."""

    voxel_m: float
    pings: tuple[int, int]
    """Of each pass, as mapped."""
    corrected: Compared
    uncorrected: Compared
    first_truth_median_m: float
    first_truth_p95_m: float
    place_median_m: float
    place_p95_m: float
    place_end_m: float
    heading_median_deg: float
    odometry_median_m: float
    odometry_end_m: float


@dataclass(frozen=True, slots=True)
class Study:
    """What is dived.

    Attributes:
        place: speed, height, range, voxels.
        first, second: the passes.
        truth_voxels: of a map that are compared with the scene, which takes some time a voxel.
    """

    place: Place = PLACE
    first: Pass = FIRST
    second: Pass = SECOND
    truth_voxels: int = 5_000


def run(study: Study, out: Path) -> Found:
    """Simulate, map, compare, and draw into a folder; recordings that are there are taken."""
    out.mkdir(parents=True, exist_ok=True)
    place, world = study.place, World(study.place)
    paths = out / "first.mcap", out / "second.mcap"
    for path, what in zip(paths, (study.first, study.second), strict=True):
        if not path.exists():
            record(path, what, world.scenario, place)
    first = mapped(paths[0], plain(place, study.first.seed), out / "first")
    _, poses = ping_poses(study.second, world.scenario, place)
    seed, known = study.second.seed, out / "first" / "map.bt"
    corrected = localized(place, seed, known, poses[0])
    second = mapped(paths[1], corrected, out / "corrected")
    mapped(paths[1], plain(place, seed), out / "uncorrected")
    way = course(paths[1], corrected, study.second.over(world.scenario, place).trajectory)
    maps = {name: read_voxels(out / name / "map.ply").centres_m for name in MAPS}
    surface = TrueSurface(world.scenario.scene.triangles_m, EXACT_WITHIN_M)
    first_m = _seen_by_both(study, world, maps["first"])
    compared, panels = _compared(study, world, maps, way, surface)
    draw(out / "second-pass.png", maps["first"], panels, way)
    errors_m, odometry_m = way.errors_m(way.said), way.errors_m(way.odometry)
    return Found(
        place.voxel_m,
        (first, second),
        compared["corrected"],
        compared["uncorrected"],
        *_off_truth(surface, first_m, study.truth_voxels),
        place_median_m=round(float(np.median(errors_m)), 3),
        place_p95_m=round(float(np.quantile(errors_m, 0.95)), 3),
        place_end_m=round(float(errors_m[-1]), 3),
        heading_median_deg=round(float(np.degrees(np.median(way.errors_rad(way.said)))), 2),
        odometry_median_m=round(float(np.median(odometry_m)), 3),
        odometry_end_m=round(float(odometry_m[-1]), 3),
    )


def _compared(
    study: Study, world: World, maps: dict[str, Floats], way: Course, surface: TrueSurface
) -> tuple[dict[str, Compared], list[Panel]]:
    """Where both passes were looking, by the map's name, and its part of the picture."""
    voxel_m, first_m = study.place.voxel_m, _seen_by_both(study, world, maps["first"])
    compared, panels = {}, []
    for name, said in (("uncorrected", way.odometry), ("corrected", way.said)):
        second_m = _seen_by_both(study, world, maps[name])
        distance_m = to_nearest(second_m, maps["first"])
        there = agreement(distance_m, voxel_m)
        back = agreement(to_nearest(first_m, maps[name]), voxel_m)
        truth = _off_truth(surface, second_m, study.truth_voxels)
        compared[name] = Compared(there, back, *truth)
        title = (
            f"second pass {name}: {there.median_m:.2f} m median, {there.p95_m:.2f} m 95 %, "
            f"{there.within_voxel:.0%} within a voxel of the first"
        )
        panels.append(Panel(title, second_m, distance_m, said[:, :2]))
    return compared, panels


def _seen_by_both(study: Study, world: World, centres_m: Floats) -> Floats:
    """Those of a map's voxels that lay in the fans of both passes."""
    passes = [_fans(world, study.place, what) for what in (study.first, study.second)]
    inside = [in_fans(centres_m, fans) for fans in passes]
    return centres_m[np.all(inside, axis=0)]


def _fans(world: World, place: Place, what: Pass) -> Fans:
    driven = what.over(world.scenario, place)
    times_s, _ = ping_poses(what, world.scenario, place)
    step = max(1, round(FANS_S * what.ping_rate_hz))
    return Fans([sonar_pose(driven, t) for t in times_s[::step].tolist()], world.scenario.sonar)


def _off_truth(surface: TrueSurface, centres_m: Floats, most: int) -> tuple[float, float]:
    """Median and 95th percentile of voxels' distance to the scene's surfaces, of some of them."""
    random = np.random.default_rng(5)
    some = random.permutation(len(centres_m))[:most]
    median, p95 = np.quantile(surface.distance_m(centres_m[some]), (0.5, 0.95))
    return round(float(median), 3), round(float(p95), 3)


def main(argv: Sequence[str] | None = None) -> int:
    """Dive, print; 0 if the second pass lands within a voxel of the first."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/second-pass"))
    said = parser.parse_args(argv)
    found = run(Study(), said.out)
    print(msgspec.json.format(msgspec.json.encode(found)).decode())
    worst_m = max(found.corrected.to_first.median_m, found.corrected.from_first.median_m)
    return 0 if worst_m <= found.voxel_m else 1


if __name__ == "__main__":
    sys.exit(main())
