"""One setting on one dive: all figures."""

import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import OdometryPoses
from oculus_driver.recording import open_recording
from studies.accuracy_cost.mapping import metrics
from studies.accuracy_cost.mapping.dives import Made, capture_of, made_by, once, truth_of
from studies.accuracy_cost.mapping.knobs import config_for
from studies.accuracy_cost.study import Column, Setting, StudyDive

__all__ = [
    "COLUMNS",
    "CONVERGED",
    "COST",
    "ERROR",
    "Driven",
    "drive",
    "log_odds_error",
    "make_oracle",
    "mean_difference",
    "measure",
    "oracle_of",
    "same_rule",
]


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A map and what it took.

    Attributes:
        map: the result.
        mapped_ms: CPU time of each ping that was mapped.
        pings: that came.
    """

    map: SonarMap
    mapped_ms: list[float]
    pings: int

    @property
    def ms_per_ping(self) -> float:
        """CPU time over all pings that came, skipped ones too."""
        return sum(self.mapped_ms) / max(self.pings, 1)


def drive(setting: Setting, made: Made, capture: Path) -> Driven:
    """Map a capture with a setting; what is timed is a ping's filters and its integration."""
    config, thinning = config_for(setting, made)
    sonar_map = SonarMap(config)
    pipeline = build_pipeline(
        sonar_map, OdometryPoses(config), remarks=None, clock=time.thread_time
    )
    decoder, executor = pipeline.decoder, pipeline.executor
    mapped_ms: list[float] = []

    def do(work: object) -> None:
        if not isinstance(work, PosedPing):
            raise TypeError(f"a capture of the simulator asks for {work}")
        posed = replace(work, ping=thinning.of(work.ping))
        began_s = time.thread_time()
        result = executor.map_ping(posed)
        took_ms = 1e3 * (time.thread_time() - began_s)
        if result is not None and result.reject is None:
            mapped_ms.append(took_ms)

    with open_recording(capture) as recording:
        for chunk in recording:
            for work in decoder.feed(chunk):
                do(work)
        for work in decoder.end():
            do(work)
    return Driven(sonar_map, mapped_ms, decoder.pings)


CONVERGED = Setting("converged", {"mapping.detail": 8.0})

OTHER_RULE = ("octree.", "iwlo.", "adaptive.", "filtering.", "sonar.", "mapping.aggregation")
"""Settings that change what the log-odds mean, not how well they are known."""

Voxels = tuple[NDArray[np.int64], NDArray[np.float64]]


def _files(dive: StudyDive, folder: Path) -> tuple[Path, Path]:
    """The map, and what it took."""
    name = f"mapping-{dive.name}-{dive.seed}-finest"
    return folder / f"{name}.map", folder / f"{name}.npz"


def make_oracle(dive: StudyDive, folder: Path) -> None:
    """Map a dive's capture with the finest evidence grid, unless that is done."""
    map_file, times_file = _files(dive, folder)
    if map_file.exists() and times_file.exists():
        return
    driven = drive(CONVERGED, made_by(dive), capture_of(dive, folder))
    map_part, times_part = once(map_file), once(times_file)
    driven.map.save(map_part)
    with times_part.open("wb") as stream:
        np.savez(stream, mapped_ms=driven.mapped_ms, pings=driven.pings)
    map_part.rename(map_file)
    times_part.rename(times_file)


def oracle_of(dive: StudyDive, folder: Path) -> Driven:
    """What `make_oracle` made."""
    map_file, times_file = _files(dive, folder)
    config, _ = config_for(CONVERGED, made_by(dive))
    sonar_map = SonarMap(config)
    sonar_map.load(map_file)
    with np.load(times_file) as archive:
        return Driven(sonar_map, archive["mapped_ms"].tolist(), int(archive["pings"]))


def same_rule(setting: Setting, default: Setting) -> bool:
    """Whether the log-odds of two settings mean the same."""
    names = {*setting.overrides, *default.overrides}
    return not any(
        name.startswith(OTHER_RULE) and setting.overrides.get(name) != default.overrides.get(name)
        for name in names
    )


def log_odds_error(sonar_map: SonarMap, dive: StudyDive, folder: Path) -> float:
    """Mean absolute difference of log-odds from the converged map's, over voxels of either."""
    return mean_difference(_known(sonar_map), _known(oracle_of(dive, folder).map))


def mean_difference(one: Voxels, other: Voxels) -> float:
    """Of log-odds, absolute, over all voxels of either; what is not known has 0.

    Args:
        one: keys (N,), each once, and log-odds (N,).
        other: the same of another map.
    """
    _, here, there = np.intersect1d(one[0], other[0], assume_unique=True, return_indices=True)
    total = np.abs(one[1]).sum() + np.abs(other[1]).sum()
    total -= np.abs(one[1][here]).sum() + np.abs(other[1][there]).sum()
    total += np.abs(one[1][here] - other[1][there]).sum()
    return float(total / max(len(one[0]) + len(other[0]) - len(here), 1))


def _known(sonar_map: SonarMap) -> Voxels:
    centres_m, log_odds, _ = sonar_map.core.voxels()
    place = np.floor(centres_m / sonar_map.resolution_m).astype(np.int64) + (1 << 20)
    return place[:, 0] << 42 | place[:, 1] << 21 | place[:, 2], log_odds.astype(np.float64)


ERROR, COST = "surface_error_m", "ping_cpu_ms"

COLUMNS = (
    Column(ERROR, "surface error, both ways, m"),
    Column("accuracy_median_m", "map to surface, median, m"),
    Column("accuracy_p95_m", "map to surface, 95 %, m"),
    Column("completeness_median_m", "surface to map, median, m"),
    Column("completeness_p95_m", "surface to map, 95 %, m"),
    Column("complete_voxels", "surface mapped within 1.5 voxels", "more"),
    Column("complete_fixed", "surface mapped within 0.15 m", "more"),
    Column("f_one", "F-score at one voxel", "more"),
    Column("f_two", "F-score at two voxels", "more"),
    Column("false_share", "occupied voxels over 0.25 m from any surface"),
    Column("roc_area", "ROC area", "more"),
    Column("calibration_expected", "calibration error, expected"),
    Column("calibration_worst", "calibration error, worst bin"),
    Column("log_odds_error", "log-odds off from the converged map's, mean"),
    Column(COST, "CPU time a ping that comes, ms", repeatable=False),
    Column("mapped_cpu_median_ms", "CPU time a mapped ping, median, ms", repeatable=False),
    Column("mapped_cpu_p95_ms", "CPU time a mapped ping, 95 %, ms", repeatable=False),
    Column("memory_bytes", "memory of the map, bytes"),
    Column("file_bytes", "saved map, bytes"),
    Column("mapped_share", "pings that are mapped", "more"),
    *(Column(f"bin{i}_voxels", f"voxels of p {i / 10:g} to {(i + 1) / 10:g}") for i in range(10)),
    *(Column(f"bin{i}_said", f"their mean p, {i / 10:g} to {(i + 1) / 10:g}") for i in range(10)),
    *(Column(f"bin{i}_solid", f"solid share, {i / 10:g} to {(i + 1) / 10:g}") for i in range(10)),
)


def measure(setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
    """All columns."""
    world, seen_m = truth_of(dive, folder)
    driven = _driven(setting, dive, folder)
    edge_m = driven.map.resolution_m
    occupied_m = driven.map.voxels("occupied").centres_m
    row = asdict(metrics.surfaces(world, seen_m, occupied_m, edge_m))
    row[COST] = driven.ms_per_ping
    row |= _times(driven)
    row["memory_bytes"] = float(driven.map.memory_bytes)
    row["file_bytes"] = float(len(driven.map.core.encode_map()))
    row["mapped_share"] = len(driven.mapped_ms) / max(driven.pings, 1)
    comparable = same_rule(setting, Setting("default", {}))
    row["log_odds_error"] = log_odds_error(driven.map, dive, folder) if comparable else math.nan
    centres_m, log_odds, _ = driven.map.core.voxels()
    chosen = metrics.sampled(centres_m, edge_m)
    solid = world.touched(centres_m[chosen], edge_m)
    evidence = log_odds[chosen].astype(np.float64)
    row["roc_area"] = metrics.roc_area(evidence, solid)
    found = metrics.reliability(evidence, solid)
    row |= {"calibration_expected": found.expected, "calibration_worst": found.worst}
    for i in range(metrics.BINS):
        row[f"bin{i}_voxels"] = float(found.counts[i])
        row[f"bin{i}_said"], row[f"bin{i}_solid"] = (
            float(found.probability[i]),
            float(found.solid[i]),
        )
    row[ERROR] = row.pop("error_m")
    return {column.name: row[column.name] for column in COLUMNS}


def _driven(setting: Setting, dive: StudyDive, folder: Path) -> Driven:
    """The converged map takes a minute, and is there already."""
    if setting.key == CONVERGED.key:
        return oracle_of(dive, folder)
    return drive(setting, made_by(dive), capture_of(dive, folder))


def _times(driven: Driven) -> dict[str, float]:
    if not driven.mapped_ms:
        return {"mapped_cpu_median_ms": math.nan, "mapped_cpu_p95_ms": math.nan}
    median, p95 = np.quantile(driven.mapped_ms, (0.5, 0.95))
    return {"mapped_cpu_median_ms": float(median), "mapped_cpu_p95_ms": float(p95)}
