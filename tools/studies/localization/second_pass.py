"""Whether a second pass over a place lands on the first when pings are mapped at corrected poses.

    .venv/bin/python tools/studies/localization/second_pass.py --out out/second-pass

Both passes are recordings of simulated pings with all effects that they call for. The first is
mapped where an odometry just set has it; the vehicle then drives about with its sonar silent. The
second pass is mapped twice by `mapperd --replay`: where the odometry, drifted by then, has it, and
where localization on the first pass's map has it.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
import numpy as np
from demo.map_truth import TrueSurface, read_voxels
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sonar_sim import FramePose
from sonar_sim.scene.scenario import sonar_pose
from sonar_sim.scene.sonar import SonarSettings

from studies.localization.pass_maps import (
    FIRST,
    SECOND,
    Pass,
    PassCourse,
    course,
    localized,
    mapped,
    ping_poses,
    plain,
    record,
)
from studies.localization.world import HARBOUR, DiveArea, DiveWorld

__all__ = [
    "Fans",
    "MapAgreement",
    "MapPanel",
    "SecondPass",
    "agreement",
    "draw",
    "in_fans",
    "run",
    "to_nearest",
]


Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class MapAgreement(msgspec.Struct, frozen=True):
    """Of one direction: from the voxels of one map to the nearest of the other; metres."""

    voxels: int
    median_m: float
    p95_m: float
    within_voxel: float
    """Share."""


@dataclass(frozen=True, slots=True, eq=False)
class Fans:
    """What a pass had before its sonar, whatever stood in the way.

    Attributes:
        poses: of the sonar, map frame, at its pings.
        sonar: its aperture and range.
    """

    poses: Sequence[FramePose]
    sonar: SonarSettings


def in_fans(points_m: Floats, fans: Fans) -> Mask:
    """(N,) whether points (N, 3) lay in the fan of any ping."""
    sonar, seen = fans.sonar, np.zeros(len(points_m), dtype=np.bool_)
    sine_up = math.sin(sonar.vertical_width_rad / 2)
    sine_aside = math.sin(sonar.half_aperture_rad)
    for pose in fans.poses:
        offset = (points_m - pose.position_m) @ pose.rotation
        range_m = np.linalg.norm(offset, axis=1)
        seen |= (
            (offset[:, 0] > 0.0)
            & (range_m < sonar.range_m)
            & (np.abs(offset[:, 1]) < sine_aside * range_m)
            & (np.abs(offset[:, 2]) < sine_up * range_m)
        )
    return seen


def to_nearest(from_m: Floats, to_m: Floats) -> Floats:
    """(N,) distance of each point to the nearest of the others; infinite without one."""
    if len(to_m) == 0:
        return np.full(len(from_m), np.inf)
    distance: Floats = cKDTree(to_m).query(from_m)[0]
    return distance


def agreement(distance_m: Floats, voxel_m: float) -> MapAgreement:
    """The figures of distances.

    Raises:
        ValueError: without points.
    """
    if len(distance_m) == 0:
        raise ValueError("no voxel to compare")
    median, p95 = np.quantile(distance_m, (0.5, 0.95))
    # Centres stand on a grid: a hair more than an edge is an edge.
    within = np.mean(distance_m <= voxel_m * (1 + 1e-6))
    return MapAgreement(len(distance_m), *(round(float(part), 3) for part in (median, p95, within)))


mpl.use("Agg")


MAX_M = 1.0
"""Of distances that colours show."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPanel:
    """A second pass's map.

    Attributes:
        title: how it was mapped, and how well it agrees.
        centres_m: (N, 3) of its voxels.
        distance_m: (N,) to the nearest of the first pass.
        track_m: (M, 2) where it thought it was.
    """

    title: str
    centres_m: Floats
    distance_m: Floats
    track_m: Floats


def draw(path: Path, first_m: Floats, panels: list[MapPanel], course: PassCourse) -> None:
    """Two maps from above, each column of voxels in the colour of its middle one; errors below."""
    picture = plt.figure(figsize=(10, 11.5))
    rows = picture.add_gridspec(3, 2, height_ratios=(1.6, 1.6, 1.0), hspace=0.3)
    window_m = _window_m(first_m, course)
    for k, panel in enumerate(panels):
        axes = picture.add_subplot(rows[k, :])
        places, _ = _columns(first_m)
        axes.scatter(places[:, 0], places[:, 1], s=1.5, color="#c8c8c8", lw=0)
        places, middle = _columns(panel.centres_m, panel.distance_m)
        colours = axes.scatter(
            places[:, 0], places[:, 1], c=middle, s=1.5, cmap="turbo", vmin=0, vmax=MAX_M, lw=0
        )
        axes.plot(*course.true[:, :2].T, color="black", lw=1.0, label="true way")
        axes.plot(*panel.track_m.T, color="#d62728", lw=1.0, label="way as mapped")
        axes.set_title(panel.title, fontsize=9)
        axes.set(aspect="equal", xlim=window_m[:, 0], ylim=window_m[:, 1], ylabel="y, m")
        axes.legend(loc="lower right", fontsize=7)
        bar = picture.colorbar(colours, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("m to the first pass (grey)", fontsize=8)
    _draw_errors(picture.add_subplot(rows[2, 0]), course, "place")
    _draw_errors(picture.add_subplot(rows[2, 1]), course, "heading")
    picture.savefig(path, dpi=85, bbox_inches="tight")
    plt.close(picture)


def _window_m(first_m: Floats, course: PassCourse) -> Floats:
    """(2, 2) corners around the ways and what stands beside them; single far voxels lie outside."""
    most = np.quantile(first_m[:, :2], (0.005, 0.98), axis=0)
    both = np.concatenate([most, course.true[:, :2], course.odometry[:, :2]])
    return np.stack([both.min(axis=0) - 1.0, both.max(axis=0) + 1.0])


def _draw_errors(axes: Axes, course: PassCourse, what: str) -> None:
    since_s = course.time_s - course.time_s[0]
    for track, name, colour in (
        (course.odometry, "odometry", "#9a9a9a"),
        (course.estimate, "localization", "#1f77b4"),
    ):
        place = what == "place"
        errors = course.errors_m(track) if place else np.degrees(course.errors_rad(track))
        axes.plot(since_s, errors, color=colour, lw=0.9, label=name)
    axes.set_ylim(0.0, None)
    axes.set_ylabel("error of the place, m" if what == "place" else "error of the heading, deg")
    axes.set_xlabel("seconds of the second pass")
    axes.legend(fontsize=7)


def _columns(centres_m: Floats, value: Floats | None = None) -> tuple[Floats, Floats]:
    """(C, 2) places that have voxels, seen from above, and the median value of each (C,)."""
    value = np.zeros(len(centres_m)) if value is None else value
    order = np.lexsort((value, centres_m[:, 1], centres_m[:, 0]))
    places, first, count = np.unique(
        centres_m[order, :2], axis=0, return_index=True, return_counts=True
    )
    return places, value[order][first + count // 2]


PLACE = dataclasses.replace(HARBOUR, speed_mps=0.8)
FANS_S = 1.0
"""Between the pings whose fans show where a pass was looking."""
EXACT_WITHIN_M = 0.5
"""Of the comparison with the truth."""
MAPS = ("first", "corrected", "uncorrected")


class Compared(msgspec.Struct, frozen=True):
    """A map of the second pass with the first pass's, and with the scene."""

    to_first: MapAgreement
    from_first: MapAgreement
    truth_median_m: float
    truth_p95_m: float


class SecondPassResult(msgspec.Struct, frozen=True):
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
class SecondPass:
    """What is dived.

    Attributes:
        place: speed, height, range, voxels.
        first, second: the passes.
        truth_voxels: of a map that are compared with the scene, which takes some time a voxel.
    """

    place: DiveArea = PLACE
    first: Pass = FIRST
    second: Pass = SECOND
    truth_voxels: int = 5_000


def run(study: SecondPass, out: Path) -> SecondPassResult:
    """Simulate, map, compare, and draw into a folder; recordings that are there are taken."""
    out.mkdir(parents=True, exist_ok=True)
    place, world = study.place, DiveWorld(study.place)
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
    errors_m, odometry_m = way.errors_m(way.estimate), way.errors_m(way.odometry)
    return SecondPassResult(
        place.voxel_m,
        (first, second),
        compared["corrected"],
        compared["uncorrected"],
        *_off_truth(surface, first_m, study.truth_voxels),
        place_median_m=round(float(np.median(errors_m)), 3),
        place_p95_m=round(float(np.quantile(errors_m, 0.95)), 3),
        place_end_m=round(float(errors_m[-1]), 3),
        heading_median_deg=round(float(np.degrees(np.median(way.errors_rad(way.estimate)))), 2),
        odometry_median_m=round(float(np.median(odometry_m)), 3),
        odometry_end_m=round(float(odometry_m[-1]), 3),
    )


def _compared(
    study: SecondPass,
    world: DiveWorld,
    maps: dict[str, Floats],
    way: PassCourse,
    surface: TrueSurface,
) -> tuple[dict[str, Compared], list[MapPanel]]:
    """Where both passes were looking, by the map's name, and its part of the picture."""
    voxel_m, first_m = study.place.voxel_m, _seen_by_both(study, world, maps["first"])
    compared, panels = {}, []
    for name, estimate in (("uncorrected", way.odometry), ("corrected", way.estimate)):
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
        panels.append(MapPanel(title, second_m, distance_m, estimate[:, :2]))
    return compared, panels


def _seen_by_both(study: SecondPass, world: DiveWorld, centres_m: Floats) -> Floats:
    """Those of a map's voxels that lay in the fans of both passes."""
    passes = [_fans(world, study.place, what) for what in (study.first, study.second)]
    inside = [in_fans(centres_m, fans) for fans in passes]
    return centres_m[np.all(inside, axis=0)]


def _fans(world: DiveWorld, place: DiveArea, what: Pass) -> Fans:
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
    args = parser.parse_args(argv)
    found = run(SecondPass(), args.out)
    print(msgspec.json.format(msgspec.json.encode(found)).decode())
    worst_m = max(found.corrected.to_first.median_m, found.corrected.from_first.median_m)
    return 0 if worst_m <= found.voxel_m else 1


if __name__ == "__main__":
    sys.exit(main())
