"""Dives that localization is measured on, and their files: scans, odometry, truth and maps."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.scan import Scan
from studies.accuracy_cost.study import StudyDive
from studies.localization.scans import cast_scan
from studies.localization.world import WORLDS, DiveArea, DiveWorld, OdometryDrift, drifted, track_of

__all__ = [
    "CELLS",
    "DIVES",
    "PLANS",
    "FilterPlan",
    "FilterRun",
    "load_runs",
    "map_path",
    "prepare_dive",
]

Floats = NDArray[np.float64]

CELLS = (1.0, 1.5, 2.0, 3.0, 5.0)
"""Edges of the maps' voxels, of the place's own."""

INTERVAL_S = 0.4
SIGMA_M, SIGMA_RAD = 0.5, math.radians(6.0)
"""Of a start that is known."""

OTHER = 100_000
"""Between seeds of paths that have nothing to do with each other."""

ARRAYS = ("bearing_rad", "range_m", "points_m", "quality", "beam")
"""Of a scan, a row a return."""


@dataclass(frozen=True, slots=True)
class FilterPlan:
    """What is dived.

    Attributes:
        scene: of `WORLDS`.
        duration_s: of one run.
        tracks: paths, each with scans and odometry of its own.
        repeats: runs on each, with other particles.
        anywhere: runs, the first ones, of whose start nothing is known.
        wrong: runs, the next ones, that begin at a wrong place and take it for known, as a vehicle
            does that was carried off. All others know their start to half a metre and 6 degrees.
    """

    scene: str
    duration_s: float
    tracks: int
    repeats: int
    anywhere: int = 0
    wrong: int = 0

    @property
    def place(self) -> DiveArea:
        """Where it is."""
        return WORLDS[self.scene]


PLANS = {
    "harbour": FilterPlan("harbour", 50.0, 3, 1),
    "harbour-lost": FilterPlan("harbour", 24.0, 12, 1, anywhere=8, wrong=4),
    "pile_field": FilterPlan("pile_field", 40.0, 3, 1),
    "tank": FilterPlan("tank", 30.0, 1, 9),
}
DIVES = (
    StudyDive("harbour", 11),
    StudyDive("harbour-lost", 21),
    StudyDive("pile_field", 31),
    StudyDive("tank", 41, quick=True),
)


@dataclass(frozen=True, slots=True, eq=False)
class FilterRun:
    """One path.

    Attributes:
        scans: of it.
        true: (N, 6) x, y, z, roll, pitch, yaw of the base at each.
        odometry: (N, 3) x, y, yaw of the odometry.
        start: about where it begins; None is anywhere.
    """

    scans: list[Scan]
    true: Floats
    odometry: Floats
    start: PlanarGaussian | None


def map_path(folder: Path, cells: float) -> Path:
    """Of the map whose voxels have so many times the place's edge."""
    return folder / f"cells-{cells:g}.map"


def prepare_dive(dive: StudyDive, folder: Path) -> None:
    """Cast the scans and write the maps; what is there and whole is kept."""
    plan = PLANS[dive.name]
    world = DiveWorld(plan.place)
    for cells in CELLS:
        path = map_path(folder, cells)
        if not path.exists():
            place = dataclasses.replace(plan.place, voxel_m=cells * plan.place.voxel_m)
            part = path.with_name(f"part-{path.name}")
            DiveWorld(place).true_map.save(part)
            part.rename(path)
    for number in range(plan.tracks):
        path = _run_path(folder, number)
        if not path.exists():
            wrong = plan.anywhere <= number < plan.anywhere + plan.wrong
            arrays = _cast(world, plan, dive.seed + number, starts_wrong=wrong)
            part = path.with_name(f"part-{path.name}")
            np.savez(part, **arrays)
            part.rename(path)


def load_runs(dive: StudyDive, folder: Path) -> list[FilterRun]:
    """The prepared runs."""
    plan = PLANS[dive.name]
    return [
        _read(_run_path(folder, number), start_is_known=number >= plan.anywhere)
        for number in range(plan.tracks)
    ]


def _run_path(folder: Path, number: int) -> Path:
    return folder / f"run-{number}.npz"


def _cast(world: DiveWorld, plan: FilterPlan, seed: int, *, starts_wrong: bool) -> dict[str, Any]:
    track = track_of(plan.place, plan.duration_s, INTERVAL_S, seed)
    random = np.random.default_rng((seed, 3))
    other = track_of(plan.place, INTERVAL_S, INTERVAL_S, seed + OTHER)
    start = (other if starts_wrong else track).place[0, [0, 1, 5]]
    start = start + [SIGMA_M, SIGMA_M, SIGMA_RAD] * random.normal(size=3)
    stamps = np.round(track.time_s * 1e9).astype(np.int64)
    scans = [
        cast_scan(world, place, int(stamp), random)
        for place, stamp in zip(track.place, stamps, strict=True)
    ]
    parts = {name: np.concatenate([getattr(scan, name) for scan in scans]) for name in ARRAYS}
    return parts | {
        "counts": np.array([len(scan) for scan in scans]),
        "levels": np.stack([scan.level_T_sonar for scan in scans]),
        "max_range_m": np.array(scans[0].max_range_m),
        "stamps": stamps,
        "true": track.place,
        "odometry": drifted(track, plan.place, OdometryDrift(), seed),
        "start": start,
    }


def _read(path: Path, *, start_is_known: bool) -> FilterRun:
    with np.load(path) as file:
        data = dict(file)
    ends = np.cumsum(data["counts"])
    parts = [np.split(data[name], ends[:-1]) for name in ARRAYS]
    bearing_rad, range_m, points_m, quality, beam = parts
    scans = [
        Scan(
            int(stamp),
            bearing_rad[k],
            range_m[k],
            points_m[k],
            quality[k],
            beam[k],
            np.zeros(0),
            float(data["max_range_m"]),
            data["levels"][k],
        )
        for k, stamp in enumerate(data["stamps"])
    ]
    start = None
    if start_is_known:
        x_m, y_m, yaw_rad = data["start"].tolist()
        variances = np.diag([SIGMA_M**2, SIGMA_M**2, SIGMA_RAD**2])
        start = PlanarGaussian(x_m, y_m, yaw_rad, variances)
    return FilterRun(scans, data["true"], data["odometry"], start)
