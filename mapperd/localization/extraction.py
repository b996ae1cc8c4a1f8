"""From a ping to a scan: what happens to a ping that the vehicle is to be found by."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.imaging.ping_image import Echo
from mapperd.localization.aperture import heard_aperture_rad
from mapperd.localization.burst_filter import BurstWatch
from mapperd.localization.detector import FirstReturns, Limits, first_returns
from mapperd.localization.floor_gate import floor_gate_m
from mapperd.localization.levelling import fan_points
from mapperd.localization.levels import equalised, levels_db
from mapperd.localization.scan import Scan
from mapperd.reject import Reject

__all__ = ["Surroundings", "scan_of"]

Floats = NDArray[np.float64]

EDGE_CELLS = 2
"""Rows by which two looks at one surface differ: speckle moves its edge."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What else is known when a ping comes.

    Attributes:
        stamp_ns: when the sound met the middle of the image, on the clock of the odometry.
        level_T_sonar: (4, 4) rigid transform: attitude and mounting, without the heading.
        height_m: of the sonar above the floor; None is unknown.
        depth_m: of the sonar below the surface; None is unknown.
        gamma_byte: exponent gamma/255 was applied to the image; 0 and 255 mean none.
    """

    stamp_ns: int
    level_T_sonar: Floats  # noqa: N815 frames are named
    height_m: float | None = None
    depth_m: float | None = None
    gamma_byte: int = 255


def scan_of(
    echo: Echo, around: Surroundings, config: Config, watch: BurstWatch | None = None
) -> Scan | Reject:
    """Take the first surface of each beam out of a ping.

    Args:
        echo: intensities and geometry, without stripes where those are filtered.
        around: what else is known.
        config: the settings.
        watch: has seen the pings before; None takes the ping as it is.

    Returns:
        The scan, perhaps without a return; or why there is none: `burst`.
    """
    settings, cell_m = config.localization.scan, echo.range_resolution_m
    limits = Limits(
        max(config.filtering.min_range, config.amcl.laser_min_range),
        min(echo.max_range_m, config.amcl.laser_max_range),
        cell_m,
    )
    levels = levels_db(echo.intensity, around.gamma_byte)
    levels = equalised(levels, cell_m) if settings.equalise else levels
    found = first_returns(levels, echo, limits, settings)
    if watch is not None:
        share = watch.share(around.stamp_ns, echo.bearings_rad, found.range_m, EDGE_CELLS * cell_m)
        if share > settings.burst_share:
            return Reject("burst", f"{share:.0%} of the returns are nowhere in the pings before")
    return _placed(found, echo, around, config, limits.max_range_m)


def _placed(
    found: FirstReturns, echo: Echo, around: Surroundings, config: Config, max_range_m: float
) -> Scan:
    settings = config.localization.scan
    # A surface that rises slowly may have its edge outside the limits that its samples keep to.
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
