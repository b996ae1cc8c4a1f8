"""One setting on one dive: all figures."""

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np

from studies.accuracy_cost.mapping import metrics
from studies.accuracy_cost.mapping.dives import capture_of, made_by, truth_of
from studies.accuracy_cost.mapping.driving import Driven, drive
from studies.accuracy_cost.mapping.oracle import CONVERGED, log_odds_error, oracle_of, same_rule
from studies.accuracy_cost.study import Column, Dive, Setting

__all__ = ["COLUMNS", "COST", "ERROR", "measure"]

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


def measure(setting: Setting, dive: Dive, folder: Path) -> dict[str, float]:
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
    told = log_odds[chosen].astype(np.float64)
    row["roc_area"] = metrics.roc_area(told, solid)
    found = metrics.reliability(told, solid)
    row |= {"calibration_expected": found.expected, "calibration_worst": found.worst}
    for i in range(metrics.BINS):
        row[f"bin{i}_voxels"] = float(found.counts[i])
        row[f"bin{i}_said"], row[f"bin{i}_solid"] = float(found.said[i]), float(found.solid[i])
    row[ERROR] = row.pop("error_m")
    return {column.name: row[column.name] for column in COLUMNS}


def _driven(setting: Setting, dive: Dive, folder: Path) -> Driven:
    """The converged map takes a minute, and is there already."""
    if setting.key == CONVERGED.key:
        return oracle_of(dive, folder)
    return drive(setting, made_by(dive), capture_of(dive, folder))


def _times(driven: Driven) -> dict[str, float]:
    if not driven.mapped_ms:
        return {"mapped_cpu_median_ms": math.nan, "mapped_cpu_p95_ms": math.nan}
    median, p95 = np.quantile(driven.mapped_ms, (0.5, 0.95))
    return {"mapped_cpu_median_ms": float(median), "mapped_cpu_p95_ms": float(p95)}
