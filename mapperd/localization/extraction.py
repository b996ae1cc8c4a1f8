"""From a ping to a scan: first returns, without floor, water surface and bursts.

Floor and surface: if the fan's plane is tilted down by g and the vertical aperture is B, a level
floor h below the sonar enters the aperture at slant range h / sin(g + B / 2), and the surface d
above it at d / sin(B / 2 - g). With roll each beam has its own tilt, computed from its direction.

Bursts are pings that another sound source fills: most of their returns are new. A ping is explained
by another one if few of its returns differ by more than the vehicle can have moved. Each ping is
compared with the two before it. Neither explains a burst; the ping before a burst explains the one
after it; a real change is explained by its repetition.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.detector import (
    FirstReturns,
    RangeLimits,
    equalised,
    first_returns,
    levels_db,
)
from mapperd.localization.scan import Scan, fan_points, heard_aperture_rad, level_T_base
from mapperd.mapping.sonar_map import mounting
from mapperd.odometry.fusion import FusedPose

__all__ = [
    "BurstState",
    "BurstWatch",
    "ScanContext",
    "burst_watch",
    "floor_gate_m",
    "scan_at",
    "scan_of",
    "unexplained_share",
]

Floats = NDArray[np.float64]


MIN_RETURNS = 16
"""Minimum number of returns for a share."""


class BurstState(NamedTuple):
    """State of a `BurstWatch`: its limits, and times, bearings and ranges of the last pings."""

    max_speed_mps: float
    max_turn_radps: float
    last: list[tuple[int, Floats, Floats]]


@dataclass(frozen=True, slots=True, eq=False)
class _SeenScan:
    stamp_ns: int
    bearing_rad: Floats
    range_m: Floats


def unexplained_share(
    bearing_rad: Floats, range_m: Floats, before_m: Floats, *, moved_m: float, turned_rad: float
) -> float:
    """Return the share of a ping's returns that another ping does not explain.

    Another return explains one if a turn can have moved its beam there and if the ranges differ by
    no more than the vehicle can have moved.

    Args:
        bearing_rad: (beams,) increasing.
        range_m: (beams,), NaN where there is no return.
        before_m: (beams,) ranges of the other ping.
        moved_m: maximum motion between the pings.
        turned_rad: maximum turn between the pings.

    Returns:
        0..1; 0 where there are no returns.
    """
    beams = len(bearing_rad)
    spacing = (bearing_rad[-1] - bearing_rad[0]) / max(beams - 1, 1)
    reach = min(beams, 1 + math.ceil(turned_rad / max(spacing, 1e-9)))
    nearest = np.full(beams, np.inf)
    for shift in range(-reach, reach + 1):
        ours = slice(max(shift, 0), beams + min(shift, 0))
        theirs = slice(max(-shift, 0), beams + min(-shift, 0))
        difference = np.abs(range_m[ours] - before_m[theirs])
        nearest[ours] = np.fmin(nearest[ours], difference)
    returns = np.isfinite(range_m)
    count = int(returns.sum())
    return float((nearest[returns] > moved_m).sum()) / count if count else 0.0


class BurstWatch:
    """Compares each ping with the two before it.

    Args:
        max_speed_mps: maximum speed of the vehicle.
        max_turn_radps: maximum turn rate of the vehicle.
    """

    def __init__(self, max_speed_mps: float, max_turn_radps: float) -> None:
        self._max_speed_mps = max_speed_mps
        self._max_turn_radps = max_turn_radps
        self._last: tuple[_SeenScan, ...] = ()

    def state(self) -> BurstState:
        """Return the state for `restored`."""
        last = [(one.stamp_ns, one.bearing_rad, one.range_m) for one in self._last]
        return BurstState(self._max_speed_mps, self._max_turn_radps, last)

    @classmethod
    def restored(cls, state: BurstState) -> "BurstWatch":
        """Return the watch that `state` was taken from."""
        watch = cls(state.max_speed_mps, state.max_turn_radps)
        watch._last = tuple(_SeenScan(*seen) for seen in state.last)
        return watch

    def share(self, stamp_ns: int, bearing_rad: Floats, range_m: Floats, cell_m: float) -> float:
        """Return the share of returns that no earlier ping explains, 0..1; remember the ping.

        Args:
            stamp_ns: time of the ping, always on the same clock.
            bearing_rad: (beams,).
            range_m: (beams,), NaN where there is no return.
            cell_m: difference of ranges that always counts as equal.
        """
        seen = _SeenScan(stamp_ns, bearing_rad, range_m)
        shares = [self._share(seen, other, cell_m) for other in self._last]
        self._last = (*self._last, seen)[-2:]
        enough = np.isfinite(range_m).sum() >= MIN_RETURNS
        return min((one for one in shares if one is not None), default=0.0) if enough else 0.0

    def _share(self, seen: _SeenScan, other: _SeenScan, cell_m: float) -> float | None:
        """Return the share against one ping; None if its beams differ."""
        if not np.array_equal(seen.bearing_rad, other.bearing_rad):
            return None
        passed_s = abs(seen.stamp_ns - other.stamp_ns) / 1e9
        return unexplained_share(
            seen.bearing_rad,
            seen.range_m,
            other.range_m,
            moved_m=cell_m + self._max_speed_mps * passed_s,
            turned_rad=min(self._max_turn_radps * passed_s, math.pi),
        )


def floor_gate_m(
    bearing_rad: Floats,
    level_T_sonar: Floats,  # noqa: N803 frames are named
    vertical_aperture_rad: float,
    *,
    height_m: float | None,
    depth_m: float | None,
) -> Floats:
    """Return the slant range (N,) beyond which a return may be floor or surface; else infinite.

    Args:
        bearing_rad: (N,), positive to starboard.
        level_T_sonar: (4, 4) rigid transform.
        vertical_aperture_rad: full.
        height_m: height of the sonar above the floor; None, unknown, disables the gate.
        depth_m: depth of the sonar below the surface; likewise.
    """
    lowest, highest = _steepest(bearing_rad, level_T_sonar[2, :3], vertical_aperture_rad / 2)
    gate = np.full(len(bearing_rad), np.inf)
    for distance_m, sine in ((height_m, -lowest), (depth_m, highest)):
        if distance_m is not None and math.isfinite(distance_m):
            reached = sine > 0
            slant = max(distance_m, 0.0) / sine[reached]
            gate[reached] = np.minimum(gate[reached], slant)
    return gate


def _steepest(bearing_rad: Floats, up: Floats, half_rad: float) -> tuple[Floats, Floats]:
    """Return the minimum and maximum sine of the level elevation within each beam's aperture.

    A direction at elevation e has the height A cos e + B sin e. Its extremes are at the edges of
    the aperture, or at atan2(B, A) and its opposite if these lie within.
    """
    along = up[0] * np.cos(bearing_rad) - up[1] * np.sin(bearing_rad)
    across = np.full_like(along, up[2])
    edges = [along * math.cos(e) + across * math.sin(e) for e in (-half_rad, half_rad)]
    lowest, highest = np.minimum(*edges), np.maximum(*edges)
    size = np.hypot(along, across)
    top = np.arctan2(across, along)
    bottom = np.arctan2(-across, -along)
    return (
        np.where(np.abs(bottom) <= half_rad, -size, lowest),
        np.where(np.abs(top) <= half_rad, size, highest),
    )


EDGE_CELLS = 2
"""Rows by which two observations of a surface differ, because speckle moves its edge."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanContext:
    """Data of a scan apart from the image.

    Attributes:
        stamp_ns: when the sound met the middle of the image, on the clock of the odometry.
        level_T_sonar: (4, 4) rigid transform: attitude and mounting, without the heading.
        height_m: height of the sonar above the floor; None if unknown.
        depth_m: depth of the sonar below the surface; None if unknown.
    """

    stamp_ns: int
    level_T_sonar: Floats  # noqa: N815 frames are named
    height_m: float | None = None
    depth_m: float | None = None


def scan_of(
    image: PingImage, around: ScanContext, config: Config, watch: BurstWatch | None = None
) -> Scan | Reject:
    """Extract the first surface of each beam from a ping.

    Args:
        image: intensities and geometry, after the filters.
        around: pose and depth.
        config: the settings.
        watch: knows the pings before; None skips the test for bursts.

    Returns:
        The scan, possibly without returns, or a reject: `burst`.
    """
    settings, cell_m = config.localization.scan, image.range_resolution_m
    limits = RangeLimits(
        max(config.filtering.min_range, config.amcl.laser_min_range),
        min(image.max_range_m, config.amcl.laser_max_range),
        cell_m,
    )
    levels = levels_db(image.intensity, image.gamma_byte)
    levels = equalised(levels, cell_m) if settings.equalise else levels
    found = first_returns(levels, image, limits, settings)
    if watch is not None:
        share = watch.share(around.stamp_ns, image.bearings_rad, found.range_m, EDGE_CELLS * cell_m)
        if share > settings.burst_share:
            return Reject("burst", f"{share:.0%} of the returns are nowhere in the pings before")
    return _placed(found, image, around, config, limits.max_range_m)


def _placed(
    found: FirstReturns, image: PingImage, around: ScanContext, config: Config, max_range_m: float
) -> Scan:
    settings = config.localization.scan
    # The edge of a slowly rising surface may lie outside of the limits for its samples.
    there = np.isfinite(found.range_m) & (found.range_m <= max_range_m)
    quality = found.height_db / np.maximum(found.height_db + settings.threshold, 1e-9)
    quality = np.clip(quality, 0.0, 1.0)
    if settings.floor_gate != "off":
        gate_m = floor_gate_m(
            image.bearings_rad,
            around.level_T_sonar,
            heard_aperture_rad(config.sonar),
            height_m=around.height_m,
            depth_m=around.depth_m,
        )
        maybe_floor = found.range_m >= gate_m
        quality = np.where(maybe_floor, settings.floor_quality * quality, quality)
        there &= ~maybe_floor if settings.floor_gate == "drop" else True
    beam = np.flatnonzero(there)
    bearing, range_m = image.bearings_rad[beam], found.range_m[beam]
    return Scan(
        around.stamp_ns,
        bearing,
        range_m,
        fan_points(range_m, bearing, around.level_T_sonar),
        quality[beam],
        beam,
        image.bearings_rad[~np.isfinite(found.range_m)],
        max_range_m,
        np.array(around.level_T_sonar, dtype=np.float64),
    )


UNNAMED = ("", "none")
"""Names of the depth's source that mean no source."""


def burst_watch(config: Config) -> BurstWatch:
    """Return a watch that distinguishes bursts from changes by the vehicle's motion."""
    limits = config.odometry.limits
    return BurstWatch(limits.max_speed, math.radians(limits.max_turn_rate))


def scan_at(
    image: PingImage, pose: FusedPose, t_ns: int, config: Config, watch: BurstWatch
) -> Scan | Reject:
    """Extract the first surface of each beam from a ping with a pose.

    Args:
        image: the filtered image.
        pose: pose of the base at that time; only attitude and depth are used.
        t_ns: time of the ping.
        config: the settings.
        watch: knows the pings before.

    Returns:
        The scan, or a reject: `burst`.
    """
    return scan_of(image, _around(pose, t_ns, config), config, watch)


def _around(pose: FusedPose, t_ns: int, config: Config) -> ScanContext:
    """Return the context of a scan: surface at height 0 if a depth source is set, floor unknown."""
    level_T_sonar = level_T_base(pose.pose.map_q_base) @ mounting(config)  # noqa: N806 frames
    depth_m = None
    if config.odometry.owners.depth not in UNNAMED:
        depth_m = -float(pose.pose.position_m[2]) - float(level_T_sonar[2, 3])
    return ScanContext(t_ns, level_T_sonar, depth_m=depth_m)
