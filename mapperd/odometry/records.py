"""Odometry records in our conventions, and conversions from wire formats."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.errors import Reject
from mapperd.geometry.frames import Body, World, orientation_to_map

__all__ = [
    "MAX_COVARIANCE",
    "MAX_DEPTH_M",
    "MAX_DISTANCE_M",
    "MAX_RATE_RADPS",
    "MAX_SPEED_MPS",
    "UNKNOWN_VARIANCE",
    "Clock",
    "GeoPoint",
    "Odometry",
    "bad_number",
    "bad_numbers",
    "bad_quaternion",
    "bad_variance",
    "linear_covariance",
    "orientation",
    "symmetric",
    "turned",
    "turned_covariance",
]

Clock = Literal["unix", "boot", "arrival"]
Floats = NDArray[np.float64]

UNKNOWN_VARIANCE = 1e6
"""Variance of unknown parts in a covariance; m², rad², (m/s)² or (rad/s)²."""


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A position on the WGS-84 ellipsoid.

    Attributes:
        latitude_rad: north positive.
        longitude_rad: east positive.
        altitude_m: above mean sea level; None if unknown.
    """

    latitude_rad: float
    longitude_rad: float
    altitude_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One record; map frame ENU, base frame FLU, SI units. None is unknown, not zero.

    Attributes:
        stamp_ns: time of validity on the clock `clock`; 0 for "arrival".
        clock: "unix", "boot" (any origin of the sender), or "arrival" (no clock).
        position_m: (3,) base in map.
        map_q_base: (4,) unit quaternion (w, x, y, z).
        velocity_mps: (3,) of the base, in base axes, over ground.
        rate_radps: (3,) of the base, about base axes.
        pose_covariance: (6, 6), x y z in map axes then rotations about map axes; m and rad.
        twist_covariance: (6, 6), as velocity and rate, in base axes.
        reset_count: changes when the source's estimate jumped.
        source: the sender's name.
        velocity_map_mps: (3,) of the base over ground, in map axes.
        velocity_east_north_mps: (2,) over ground, if the vertical part is unknown.
        depth_m: below the surface, positive down, from pressure.
        geo: geographic position of the base.
        heading_rad: forward axis of the base from east, counter-clockwise, without other angles.
        altitude_m: above the bottom.
        confidence: confidence that the sender states, 0 (none) to 1.
        valid: False if the sender lost track. Such a record has only a time and interrupts dead
            reckoning.
        sent_ns: time of sending on the same clock, or None. The clock is fitted with it, because
            arrival minus this is the delay of the link alone.
        specific_force_mps2: (3,) accelerometer measurement, base axes: (0, 0, 9.8) when level.
        north_referenced: False if the sender's world has an arbitrary heading; its positions and
            orientations then do not mix with compass headings.
    """

    stamp_ns: int
    clock: Clock
    position_m: Floats | None = None
    map_q_base: Floats | None = None
    velocity_mps: Floats | None = None
    rate_radps: Floats | None = None
    pose_covariance: Floats | None = None
    twist_covariance: Floats | None = None
    reset_count: int = 0
    source: str = ""
    velocity_map_mps: Floats | None = None
    velocity_east_north_mps: Floats | None = None
    depth_m: float | None = None
    geo: GeoPoint | None = None
    heading_rad: float | None = None
    altitude_m: float | None = None
    confidence: float | None = None
    valid: bool = True
    sent_ns: int | None = None
    north_referenced: bool = True
    specific_force_mps2: Floats | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in _ARRAYS:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


_ARRAYS = (
    "position_m",
    "map_q_base",
    "velocity_mps",
    "rate_radps",
    "pose_covariance",
    "twist_covariance",
    "velocity_map_mps",
    "velocity_east_north_mps",
    "specific_force_mps2",
)

MAX_DISTANCE_M = 1e7  # a quarter of the Earth's circumference
MAX_DEPTH_M = 12e3  # deeper than any sea
MAX_SPEED_MPS = 1e3
MAX_RATE_RADPS = 1e3
MAX_COVARIANCE = 1e12
QUATERNION_TOLERANCE = 0.01  # on the norm: text with three digits passes, a wrong field does not
ZERO_NORM = 1e-6

_PLACES = np.zeros((6, 6), dtype=np.intp)
"""Index in the upper triangle of each element of a symmetric matrix."""
_PLACES[np.triu_indices(6)] = _PLACES.T[np.triu_indices(6)] = np.arange(21)
_VARIANCES = tuple(np.diag(_PLACES).tolist())


def bad_numbers(key: str, numbers: Sequence[float], limit: float) -> Reject | None:
    """Return why these numbers are invalid (not finite, or above `limit`), or None."""
    for number in numbers:
        if not -limit <= number <= limit:  # also where it is NaN
            if math.isfinite(number):
                return Reject("out_of_range", f"{key} holds {number:g}; at most {limit:g}")
            return Reject("not_finite", f"{key} holds NaN or infinity")
    return None


def bad_number(key: str, number: float, minimum: float, maximum: float) -> Reject | None:
    """Return why this number is invalid, or None."""
    if minimum <= number <= maximum:
        return None
    # Text can hold integers too large for a float: do not convert them.
    if isinstance(number, float) and not math.isfinite(number):
        return Reject("not_finite", f"{key} is {number}")
    return Reject("out_of_range", f"{key} is {str(number)[:24]}; from {minimum:g} to {maximum:g}")


def bad_quaternion(quaternion: Sequence[float]) -> Reject | None:
    """Return why these finite numbers are not an orientation, or None."""
    norm = math.hypot(*quaternion)
    if norm < ZERO_NORM:
        return Reject("zero_quaternion", "q is zero: no orientation")
    if abs(norm - 1) > QUATERNION_TOLERANCE:
        return Reject("unnormalised_quaternion", f"q has the norm {norm:.4g}, not 1")
    return None


def bad_variance(key: str, triangle: Sequence[float]) -> Reject | None:
    """Return why these 21 numbers are not the upper triangle of a covariance, or None."""
    if min(triangle[place] for place in _VARIANCES) < 0:
        return Reject("negative_variance", f"{key} has a variance below 0")
    return None


def orientation(quaternion: ArrayLike, world: World, body: Body) -> Floats:
    """Return map_q_base from a sender's almost unit (w, x, y, z), body to world."""
    map_q_base = orientation_to_map(quaternion, world, body)
    return np.asarray(map_q_base / math.hypot(*map_q_base.tolist()), dtype=np.float64)


def turned(rotation: Floats, numbers: Sequence[float]) -> Floats:
    """Return a vector (3,) in other axes."""
    return rotation @ np.array(numbers, dtype=np.float64)


def symmetric(triangle: Sequence[float]) -> Floats:
    """Return (6, 6) from the 21 numbers of its upper triangle, row by row."""
    return np.array(triangle, dtype=np.float64)[_PLACES]


def turned_covariance(rotation: Floats, matrix: Floats) -> Floats:
    """Return a covariance (6, 6) in other axes; the linear and angular blocks rotate alike."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    return np.asarray(both @ matrix @ both.T, dtype=np.float64)


def linear_covariance(matrix: Floats) -> Floats:
    """Return (6, 6) from a linear part (3, 3); the angular part is unknown.

    Linear variances above UNKNOWN_VARIANCE are limited to it, so that a sender's 1e9 does not
    drown small numbers next to it.
    """
    whole = UNKNOWN_VARIANCE * np.eye(6)
    if np.diag(matrix).max() <= UNKNOWN_VARIANCE:
        whole[:3, :3] = matrix
    return whole
