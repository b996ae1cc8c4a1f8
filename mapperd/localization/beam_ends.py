"""Where the ends of a scan's beams may be: a ping knows range and bearing, and no elevation.

A line array measures the component of a direction along itself, so all directions of one bearing b
lie on the cone of sin(b): at elevation e they stand at (sqrt(1 - sin(b)^2 - sin(e)^2), -sin(b),
sin(e)). Off the fan's plane and away from its middle that is not the vertical plane of the bearing:
at 60 deg and 10 deg it is 1.6 deg beside it.
"""

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.scan import Scan

__all__ = ["elevation_fan_rad", "ends_on_cones"]

Floats = NDArray[np.float64]


def elevation_fan_rad(count: int, vertical_aperture_rad: float) -> Floats:
    """(count,) elevations: the middles of equal parts of the aperture."""
    return ((np.arange(count) + 0.5) / count - 0.5) * vertical_aperture_rad


def ends_on_cones(scan: Scan, elevation_rad: Floats, base_height_m: float) -> Floats:
    """Ends (N, E, 3) for each return and elevation.

    Args:
        scan: the returns.
        elevation_rad: (E,) above the fan's plane, sonar frame.
        base_height_m: of the base in the map.

    Returns:
        x ahead and y to port in the level frame, and the height in the map frame; metres.
    """
    sine, up = np.sin(scan.bearing_rad)[:, None], np.sin(elevation_rad)[None, :]
    # Beside an array's axis no direction has the elevation: there the cone's own edge stands in.
    edge = np.abs(np.cos(scan.bearing_rad))[:, None]
    up = np.clip(up, -edge, edge)
    ahead = np.sqrt(np.maximum(1.0 - sine**2 - up**2, 0.0))
    directions = np.stack([ahead, np.broadcast_to(-sine, ahead.shape), up], axis=-1)
    turn, place = scan.level_T_sonar[:3, :3], scan.level_T_sonar[:3, 3]
    ends: Floats = scan.range_m[:, None, None] * (directions @ turn.T) + place
    ends[..., 2] += base_height_m
    return ends
