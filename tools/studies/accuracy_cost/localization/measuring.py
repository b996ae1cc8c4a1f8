"""Localization as a study: prepares its dives and measures settings on them."""

import ctypes
import gc
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.geometry.gaussian import wrapped
from mapperd.localization.known_map import load_known_map
from mapperd.localization.localizer import Localized, Localizer
from mapperd.localization.map_filter import MapFilter
from mapperd.localization.scan import yaw_of
from studies.accuracy_cost.localization.dives import (
    DIVES,
    PLANS,
    FilterRun,
    load_runs,
    map_path,
    prepare_dive,
)
from studies.accuracy_cost.localization.knobs import KNOBS, WHOLES, config_for
from studies.accuracy_cost.study import Column, Knob, Setting, StudyDive

__all__ = [
    "COLUMNS",
    "COST",
    "ERROR",
    "LocalizationStudy",
    "Moments",
    "figures_of",
    "localize",
    "resident_bytes",
]


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Of one run, a row a scan from the first update on, but for the times.

    Attributes:
        error_m, turn_rad: of the pose that the odometry has by the last update, without signs.
        unsure: what is believed calls itself ambiguous.
        nees: of updates alone: squared error by the estimate's covariance, three dimensions.
        scan_s: (N,) CPU of each scan of the run.
        update_s: (M,) of those that were updates.
    """

    error_m: Floats
    turn_rad: Floats
    unsure: NDArray[np.bool_]
    nees: Floats
    scan_s: Floats
    update_s: Floats


def localize(
    path: Path, runs: list[FilterRun], repeats: int, config: Config
) -> tuple[list[Moments], int]:
    """Localize runs, one after the other, by one filter, whose random numbers go on.

    Args:
        path: of the map.
        runs: that are localized.
        repeats: of each.
        config: the settings.

    Returns:
        what came of each; bytes of memory that map and filter take, about.
    """
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # else what the setting before has left is taken again
    before = resident_bytes()
    known = load_known_map(path, config).map
    localizer = Localizer(MapFilter(config), config)
    localizer.take_map(known)
    moments = [_run(localizer, run, config) for run in runs for _ in range(repeats)]
    return moments, max(resident_bytes() - before, 0)


def _run(localizer: Localizer, run: FilterRun, config: Config) -> Moments:
    if run.start is None:
        localizer.localize_globally()
    else:
        localizer.take_pose(run.start, config.amcl.global_frame_id)
    errors, unsure, nees, scan_s, update_s = [], [], [], [], []
    is_unsure = False
    for scan, true, odom in zip(run.scans, run.true, _poses(run), strict=True):
        began_s = time.thread_time()
        found = localizer.take_scan(scan, odom)
        scan_s.append(time.thread_time() - began_s)
        if found.belief is not None:
            is_unsure = found.belief.ambiguous
            update_s.append(scan_s[-1])
            nees.append(_nees(found, true))
        if localizer.correction is not None:
            pose = localizer.correction.corrected(odom)
            errors.append(_off(pose, true))
            unsure.append(is_unsure)
    error_m, turn_rad = np.array(errors).reshape(-1, 2).T
    arrays = (error_m, turn_rad, np.array(unsure, bool), np.array(nees))
    return Moments(*arrays, np.array(scan_s), np.array(update_s))


def _poses(run: FilterRun) -> Iterator[Pose]:
    """Of the base, as odometry and the sensors of depth, roll and pitch have it."""
    for true, estimate in zip(run.true, run.odometry, strict=True):
        roll_pitch_yaw_deg = tuple(np.degrees([true[3], true[4], estimate[2]]).tolist())
        yield pose_from_rpy(
            (float(estimate[0]), float(estimate[1]), float(true[2])), roll_pitch_yaw_deg
        )


def _off(pose: Pose, true: Floats) -> tuple[float, float]:
    off_m = math.hypot(*(pose.position_m[:2] - true[:2]))
    return off_m, abs(wrapped(yaw_of(pose.map_q_base) - true[5]))


def _nees(found: Localized, true: Floats) -> float:
    """Squared error of the best mode, by its covariance."""
    best = found.estimate
    assert best is not None  # noqa: S101 it is an update
    error = np.array([best.x_m - true[0], best.y_m - true[1], wrapped(best.yaw_rad - true[5])])
    return float(error @ np.linalg.pinv(best.covariance, hermitian=True) @ error)


def resident_bytes() -> int:
    """Memory of this process now."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024
    raise OSError("/proc has no entry on this process's memory")


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


class LocalizationStudy:
    """The study; the defaults are those of `config/localization.yaml`."""

    name = "localization"
    knobs: tuple[Knob, ...] = KNOBS
    dives: tuple[StudyDive, ...] = DIVES
    wholes: tuple[Setting, ...] = WHOLES
    columns: tuple[Column, ...] = COLUMNS
    error = ERROR
    cost = COST

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        """As of `Study`."""
        prepare_dive(dive, folder)

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        """As of `Study`."""
        plan = PLANS[dive.name]
        config = config_for(plan.place, setting.overrides, dive.seed)
        path = map_path(folder, float(setting.overrides.get("scale.cells", 1.0)))
        runs, memory = localize(path, load_runs(dive, folder), plan.repeats, config)
        return figures_of(runs, plan.place.right_m, memory)
