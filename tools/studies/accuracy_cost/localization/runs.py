"""A dive localized: where the filter says the vehicle is at each scan, and what that took."""

import ctypes
import gc
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.geometry.gaussian import wrapped
from mapperd.localization.known_map import load_known_map
from mapperd.localization.levelling import yaw_of
from mapperd.localization.localizer import Localized, Localizer
from mapperd.localization.map_filter import MapFilter
from studies.accuracy_cost.localization.dives import Run

__all__ = ["Moments", "localize", "resident_bytes"]

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
    path: Path, runs: list[Run], repeats: int, config: Config
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


def _run(localizer: Localizer, run: Run, config: Config) -> Moments:
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


def _poses(run: Run) -> Iterator[Pose]:
    """Of the base, as odometry and the sensors of depth, roll and pitch have it."""
    for true, said in zip(run.true, run.odometry, strict=True):
        roll_pitch_yaw_deg = tuple(np.degrees([true[3], true[4], said[2]]).tolist())
        yield pose_from_rpy((float(said[0]), float(said[1]), float(true[2])), roll_pitch_yaw_deg)


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
    raise OSError("/proc tells nothing of this process's memory")
