"""A scan: the surfaces in one ping or in a caller's ranges, in a level frame.

The level frame is the base without its roll and pitch: origin in the base, x ahead and level, y to
port, z up. A position and a yaw then place it in the map.

The vertical angle that a return may come from.

The map spreads an echo over the two-way half-power width, where most echoes come from. A first
return is the edge of the nearest surface and is heard farther out. Localization therefore uses the
one-way width, where a quarter of the two-way power is left. Down to that level a beam is Gaussian,
so that the one-way width is sqrt 2 times the two-way width.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.config.tree import SonarConfig
from mapperd.geometry.frames import quaternion_to_matrix

__all__ = [
    "Scan",
    "beam_directions",
    "decimated",
    "decimation",
    "fan_points",
    "heard_aperture_rad",
    "level_T_base",
    "scan_of_ranges",
    "yaw_of",
]

Floats = NDArray[np.float64]


def yaw_of(map_q_base: ArrayLike) -> float:
    """Heading of a unit quaternion (w, x, y, z), rad in -pi..pi, of Rz(yaw) Ry(pitch) Rx(roll).

    If the vehicle stands on its nose or tail the heading is undefined and 0 is returned.
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

    Horizontal ranges are the slant ranges times the cosine of the level elevation, which follows
    from the mounting's tilt, roll and pitch.
    """
    points = range_m[:, None] * beam_directions(bearing_rad, elevation_rad)
    placed: Floats = points @ level_T_sonar[:3, :3].T + level_T_sonar[:3, 3]
    return placed


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """First returns of the beams that have one; arrays are read-only.

    The level frame is the base without its roll and pitch: origin in the base, x ahead and level,
    y to port, z up. The elevation of a return is unknown; `points_m` places it in the middle of
    the beam's vertical aperture.

    Attributes:
        stamp_ns: when the sound met the middle of the image, on the clock of the odometry.
        bearing_rad: (N,) float64, increasing, in the sonar's fan, positive to starboard.
        range_m: (N,) float64, slant range from the sonar.
        points_m: (N, 3) float64, level frame.
        quality: (N,) float64, 0..1: how far the return stands out, less where it may be floor.
        beam: (N,) int64, the beams' columns in the ping.
        misses_bearing_rad: (M,) float64 bearings of the beams without a return. They carry no
            information: a smooth surface reflects sound away.
        max_range_m: range limit of the search for returns.
        level_T_sonar: (4, 4) rigid transform, sonar x along the centre beam, y to port, z up.
    """

    stamp_ns: int
    bearing_rad: Floats
    range_m: Floats
    points_m: Floats
    quality: Floats
    beam: NDArray[np.int64]
    misses_bearing_rad: Floats
    max_range_m: float
    level_T_sonar: Floats  # noqa: N815 frames are named

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __len__(self) -> int:
        return len(self.range_m)


def decimation(count: int, max_count: int) -> NDArray[np.int64]:
    """Return `max_count` evenly spaced indices below `count`, with the first and the last.

    Index k is ceil(k (count - 1) / (max_count - 1)). If `count` is not larger, all are returned; if
    `max_count` is 1, only the first.
    """
    if max_count >= count:
        return np.arange(count, dtype=np.int64)
    if max_count <= 1:
        return np.zeros(max(max_count, 0), dtype=np.int64)
    k = np.arange(max_count, dtype=np.int64)
    return -(-k * (count - 1) // (max_count - 1))


def decimated(scan: Scan, max_beams: int) -> Scan:
    """Return the scan with at most `max_beams` returns.

    Args:
        scan: the scan.
        max_beams: number of returns, evenly spaced among those of the scan.
    """
    kept = decimation(len(scan), max_beams)
    return dataclasses.replace(
        scan,
        bearing_rad=scan.bearing_rad[kept],
        range_m=scan.range_m[kept],
        points_m=scan.points_m[kept],
        quality=scan.quality[kept],
        beam=scan.beam[kept],
    )


LEVEL = np.eye(4)


def scan_of_ranges(
    stamp_ns: int,
    bearing_rad: ArrayLike,
    range_m: ArrayLike,
    level_T_sonar: NDArray[np.float64] = LEVEL,  # noqa: N803 frames are named
    quality: ArrayLike = 1.0,
) -> Scan:
    """Make a scan from one range per beam.

    Args:
        stamp_ns: time on the clock of the odometry.
        bearing_rad: (N,) increasing, in the sonar's fan, positive to starboard.
        range_m: (N,) slant ranges from the sonar; values not finite or not positive are no returns.
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


def heard_aperture_rad(sonar: SonarConfig) -> float:
    """Return the full vertical angle that a first return may come from: the one-way width."""
    return math.sqrt(2.0) * math.radians(sonar.vertical_aperture)
