"""Scans of whoever has ranges already."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.localization.levelling import fan_points
from mapperd.localization.scan import Scan

__all__ = ["scan_of_ranges"]

LEVEL = np.eye(4)


def scan_of_ranges(
    stamp_ns: int,
    bearing_rad: ArrayLike,
    range_m: ArrayLike,
    level_T_sonar: NDArray[np.float64] = LEVEL,  # noqa: N803 frames are named
    quality: ArrayLike = 1.0,
) -> Scan:
    """A scan of one range a beam.

    Args:
        stamp_ns: when, on the clock of the odometry.
        bearing_rad: (N,) increasing, in the sonar's fan, positive to starboard.
        range_m: (N,) slant ranges from the sonar; what is not finite and above 0 is no return.
        level_T_sonar: (4, 4) rigid transform: attitude and mounting, without the heading; by
            default the sonar is the base, and level.
        quality: 0..1, (N,) or one number.

    Raises:
        ValueError: the lengths differ, or a bearing is not finite.
    """
    bearing = np.array(bearing_rad, dtype=np.float64)
    ranges = np.array(range_m, dtype=np.float64)
    if bearing.ndim != 1 or bearing.shape != ranges.shape or not np.isfinite(bearing).all():
        raise ValueError("a scan has as many ranges as bearings, and these are finite")
    weights = np.broadcast_to(np.asarray(quality, dtype=np.float64), bearing.shape)
    seen = np.isfinite(ranges) & (ranges > 0)
    return Scan(
        stamp_ns=stamp_ns,
        bearing_rad=bearing[seen],
        range_m=ranges[seen],
        points_m=fan_points(ranges[seen], bearing[seen], level_T_sonar),
        quality=np.clip(weights[seen], 0.0, 1.0),
        beam=np.flatnonzero(seen),
        misses_bearing_rad=bearing[~seen],
        max_range_m=float(ranges[seen].max(initial=0.0)),
        level_T_sonar=np.array(level_T_sonar, dtype=np.float64),
    )
