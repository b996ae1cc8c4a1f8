"""Attitude taken out: from the sonar's fan to a level frame below the vehicle's heading.

The level frame is the base without its roll and pitch: origin in the base, x ahead and level, y to
port, z up. What turns the base into the map is then a position and a yaw.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.geometry.frames import quaternion_to_matrix

__all__ = ["beam_directions", "fan_points", "level_T_base", "yaw_of"]

Floats = NDArray[np.float64]


def yaw_of(map_q_base: ArrayLike) -> float:
    """Heading of a unit quaternion (w, x, y, z), rad in -pi..pi, of Rz(yaw) Ry(pitch) Rx(roll).

    A vehicle that stands on its nose or tail has none; then 0 is as good as any.
    """
    forward = quaternion_to_matrix(map_q_base)[:, 0]
    return math.atan2(forward[1], forward[0])


def level_T_base(map_q_base: ArrayLike) -> Floats:  # noqa: N802 frames are named
    """(4, 4) rotation by the roll and pitch of a unit quaternion (w, x, y, z)."""
    yaw = yaw_of(map_q_base)
    c, s = math.cos(yaw), math.sin(yaw)
    transform = np.eye(4)
    turned_back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    transform[:3, :3] = turned_back @ quaternion_to_matrix(map_q_base)
    return transform


def beam_directions(bearing_rad: Floats, elevation_rad: ArrayLike = 0.0) -> Floats:
    """Unit vectors, sonar frame: x along the centre beam, y to port, z up.

    Args:
        bearing_rad: (N,), positive to starboard.
        elevation_rad: above the fan's plane, a number or (N,).

    Returns:
        (N, 3) float64.
    """
    elevation = np.broadcast_to(np.asarray(elevation_rad, dtype=np.float64), bearing_rad.shape)
    out = np.cos(elevation)
    return np.stack(
        [out * np.cos(bearing_rad), -out * np.sin(bearing_rad), np.sin(elevation)], axis=1
    )


def fan_points(
    range_m: Floats,
    bearing_rad: Floats,
    level_T_sonar: Floats,  # noqa: N803 frames are named
    elevation_rad: ArrayLike = 0.0,
) -> Floats:
    """Points (N, 3) of slant ranges (N,) in the level frame, metres.

    Their horizontal ranges are the slant ranges times the cosine of what the mounting's tilt, roll
    and pitch make of the elevation.
    """
    points = range_m[:, None] * beam_directions(bearing_rad, elevation_rad)
    placed: Floats = points @ level_T_sonar[:3, :3].T + level_T_sonar[:3, 3]
    return placed
