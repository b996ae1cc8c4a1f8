"""Where floor and surface may be, beam by beam.

With the fan's plane tilted down by g and a vertical aperture B, a level floor h below the sonar
comes into the aperture at slant range h / sin(g + B / 2), the surface d above it at
d / sin(B / 2 - g). Rolled, each beam has a tilt of its own; here they are all taken from the beams'
directions.
"""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["floor_gate_m"]

Floats = NDArray[np.float64]


def floor_gate_m(
    bearing_rad: Floats,
    level_T_sonar: Floats,  # noqa: N803 frames are named
    vertical_aperture_rad: float,
    *,
    height_m: float | None,
    depth_m: float | None,
) -> Floats:
    """Slant range (N,) from which on a return may be floor or surface; infinite where neither.

    Args:
        bearing_rad: (N,), positive to starboard.
        level_T_sonar: (4, 4) rigid transform.
        vertical_aperture_rad: full.
        height_m: of the sonar above the floor; None is unknown, and no gate.
        depth_m: of the sonar below the surface; likewise.
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
    """Least and greatest sine of the level elevation that each beam's aperture reaches.

    A direction at elevation e has the height A cos e + B sin e; its extremes lie at the aperture's
    edges, or at atan2(B, A) and opposite of it, where they are within.
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
