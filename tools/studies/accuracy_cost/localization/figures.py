"""What a localized dive is judged by."""

import math
from collections.abc import Sequence

import numpy as np

from studies.accuracy_cost.localization.runs import Moments
from studies.accuracy_cost.study import Column

__all__ = ["COLUMNS", "COST", "ERROR", "figures_of"]

RIGHT_RAD = 0.2
MIDDLE_CHI2 = 2.366
"""Median of the chi-square distribution of three dimensions."""

ENDING = 0.25
"""Part of a run at its end, in which the right mode must be held all the time."""

ERROR, COST = "error_m", "cpu_ms_per_ping"

COLUMNS = (
    Column(
        ERROR, "position error, mean (m; a lost vehicle counts as twice the right mode's reach)"
    ),
    Column("error_se_m", "its standard error over the runs (m)"),
    Column("median_m", "position error, median (m)"),
    Column("p95_m", "position error, 95 % (m)"),
    Column("heading_median_deg", "heading error, median (degrees)"),
    Column("heading_p95_deg", "heading error, 95 % (degrees)"),
    Column("success", "share of runs that end in the right mode", better="more"),
    Column(
        "wrong_and_sure", "share of pings with a wrong pose that does not call itself ambiguous"
    ),
    Column("nees", "median NEES over that of a consistent filter (1 is consistent)"),
    Column(COST, "CPU time per ping, mean (ms)", repeatable=False),
    Column("update_median_ms", "CPU time per update, median (ms)", repeatable=False),
    Column("update_p95_ms", "CPU time per update, 95 % (ms)", repeatable=False),
    Column("memory_mb", "memory of map, fields and particles, about (MB)", repeatable=False),
)


def figures_of(runs: Sequence[Moments], right_m: float, memory: int) -> dict[str, float]:
    """The figures of all columns; NaN of what never was.

    Args:
        runs: of one dive.
        right_m: nearer than this, and within `RIGHT_RAD`, is the right mode.
        memory: bytes.
    """
    capped = [np.minimum(run.error_m, 2 * right_m) for run in runs]
    means = [float(each.mean()) if len(each) else 2 * right_m for each in capped]
    error_m = np.concatenate([run.error_m for run in runs])
    turn_rad = np.concatenate([run.turn_rad for run in runs])
    unsure = np.concatenate([run.unsure for run in runs])
    wrong = (error_m >= right_m) | (turn_rad >= RIGHT_RAD)
    spread = float(np.std(means, ddof=1)) if len(means) > 1 else math.nan
    return {
        ERROR: float(np.mean(means)),
        "error_se_m": spread / math.sqrt(len(means)),
        "median_m": _quantile(error_m, 0.5),
        "p95_m": _quantile(error_m, 0.95),
        "heading_median_deg": math.degrees(_quantile(turn_rad, 0.5)),
        "heading_p95_deg": math.degrees(_quantile(turn_rad, 0.95)),
        "success": float(np.mean([_ends_right(run, right_m) for run in runs])),
        "wrong_and_sure": float(np.mean(wrong & ~unsure)) if len(wrong) else math.nan,
        "nees": _quantile(np.concatenate([run.nees for run in runs]), 0.5) / MIDDLE_CHI2,
        COST: 1e3 * float(np.mean(np.concatenate([run.scan_s for run in runs]))),
        "update_median_ms": 1e3 * _quantile(np.concatenate([r.update_s for r in runs]), 0.5),
        "update_p95_ms": 1e3 * _quantile(np.concatenate([r.update_s for r in runs]), 0.95),
        "memory_mb": memory / 1e6,
    }


def _ends_right(run: Moments, right_m: float) -> bool:
    last = max(1, round(ENDING * len(run.error_m)))
    right = (run.error_m < right_m) & (run.turn_rad < RIGHT_RAD)
    return len(right) > 0 and bool(right[-last:].all())


def _quantile(values: np.ndarray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan
