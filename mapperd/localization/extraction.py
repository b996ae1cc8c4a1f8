"""From a ping to a scan.

The range of floor and water surface for each beam.

If the fan's plane is tilted down by g and the vertical aperture is B, a level floor h below the
sonar enters the aperture at slant range h / sin(g + B / 2), and the surface d above it at
d / sin(B / 2 - g). With roll each beam has its own tilt, computed from its direction.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.burst_filter import BurstWatch
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

__all__ = ["ScanContext", "burst_watch", "floor_gate_m", "scan_at", "scan_of"]

Floats = NDArray[np.float64]


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
    echo: PingImage, around: ScanContext, config: Config, watch: BurstWatch | None = None
) -> Scan | Reject:
    """Extract the first surface of each beam from a ping.

    Args:
        echo: intensities and geometry, after the filters.
        around: pose and depth.
        config: the settings.
        watch: knows the pings before; None skips the test for bursts.

    Returns:
        The scan, possibly without returns, or a reject: `burst`.
    """
    settings, cell_m = config.localization.scan, echo.range_resolution_m
    limits = RangeLimits(
        max(config.filtering.min_range, config.amcl.laser_min_range),
        min(echo.max_range_m, config.amcl.laser_max_range),
        cell_m,
    )
    levels = levels_db(echo.intensity, echo.gamma_byte)
    levels = equalised(levels, cell_m) if settings.equalise else levels
    found = first_returns(levels, echo, limits, settings)
    if watch is not None:
        share = watch.share(around.stamp_ns, echo.bearings_rad, found.range_m, EDGE_CELLS * cell_m)
        if share > settings.burst_share:
            return Reject("burst", f"{share:.0%} of the returns are nowhere in the pings before")
    return _placed(found, echo, around, config, limits.max_range_m)


def _placed(
    found: FirstReturns, echo: PingImage, around: ScanContext, config: Config, max_range_m: float
) -> Scan:
    settings = config.localization.scan
    # The edge of a slowly rising surface may lie outside of the limits for its samples.
    there = np.isfinite(found.range_m) & (found.range_m <= max_range_m)
    quality = found.height_db / np.maximum(found.height_db + settings.threshold, 1e-9)
    quality = np.clip(quality, 0.0, 1.0)
    if settings.floor_gate != "off":
        gate_m = floor_gate_m(
            echo.bearings_rad,
            around.level_T_sonar,
            heard_aperture_rad(config.sonar),
            height_m=around.height_m,
            depth_m=around.depth_m,
        )
        maybe_floor = found.range_m >= gate_m
        quality = np.where(maybe_floor, settings.floor_quality * quality, quality)
        there &= ~maybe_floor if settings.floor_gate == "drop" else True
    beam = np.flatnonzero(there)
    bearing, range_m = echo.bearings_rad[beam], found.range_m[beam]
    return Scan(
        around.stamp_ns,
        bearing,
        range_m,
        fan_points(range_m, bearing, around.level_T_sonar),
        quality[beam],
        beam,
        echo.bearings_rad[~np.isfinite(found.range_m)],
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
