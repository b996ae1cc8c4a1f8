"""Odometry records in our conventions, and numbers of the wire turned into them."""

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
"""m², rad², (m/s)² or (rad/s)²: stands in a covariance for a part the sender does not know."""


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A place on the WGS-84 ellipsoid.

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
    """One record; map frame ENU, base frame FLU, SI units. None is unknown, which is not zero.

    Attributes:
        stamp_ns: when it was so, on the clock that `clock` names; 0 for "arrival".
        clock: "unix", "boot" (some zero of the sender's), or "arrival" (has no clock).
        position_m: (3,) base in map.
        map_q_base: (4,) unit quaternion (w, x, y, z).
        velocity_mps: (3,) of the base, in base axes, over ground.
        rate_radps: (3,) of the base, about base axes.
        pose_covariance: (6, 6), x y z in map axes then rotations about map axes; m and rad.
        twist_covariance: (6, 6), as velocity and rate, in base axes.
        reset_count: changes when the source's estimate jumped.
        source: the sender's name.
        velocity_map_mps: (3,) of the base over ground, in map axes.
        velocity_east_north_mps: (2,) over ground, where the vertical part is not known.
        depth_m: below the surface, positive down, from pressure.
        geo: where the base is on Earth.
        heading_rad: the base's forward axis from east, counter-clockwise, without the other angles.
        altitude_m: above the bottom.
        confidence: the sender's own, 0 (none) to 1.
        valid: False if the sender reports that it has lost track. Such a record holds a
            time and breaks dead reckoning.
        sent_ns: when the record left, on the same clock; None where stamp_ns is all there is.
            The clock is fitted with it: arrival minus this is the delay of the link alone.
        specific_force_mps2: (3,) what an accelerometer measures, base axes: (0, 0, 9.8) when level.
        north_referenced: False where the horizontal axes of the sender's world have an arbitrary
            heading: its positions and orientations do not mix with compass headings.
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

MAX_DISTANCE_M = 1e7  # a quarter of the way around the Earth
MAX_DEPTH_M = 12e3  # no sea is deeper
MAX_SPEED_MPS = 1e3
MAX_RATE_RADPS = 1e3
MAX_COVARIANCE = 1e12
QUATERNION_TOLERANCE = 0.01  # on the norm: text with three digits passes, a wrong field does not
ZERO_NORM = 1e-6

_PLACES = np.zeros((6, 6), dtype=np.intp)
"""Where in its triangle each element of a symmetric matrix stands."""
_PLACES[np.triu_indices(6)] = _PLACES.T[np.triu_indices(6)] = np.arange(21)
_VARIANCES = tuple(np.diag(_PLACES).tolist())


def bad_numbers(key: str, numbers: Sequence[float], limit: float) -> Reject | None:
    """Why these numbers cannot be true, if so: not finite, or larger than `limit`."""
    for number in numbers:
        if not -limit <= number <= limit:  # also where it is NaN
            if math.isfinite(number):
                return Reject("out_of_range", f"{key} holds {number:g}; at most {limit:g}")
            return Reject("not_finite", f"{key} holds NaN or infinity")
    return None


def bad_number(key: str, number: float, minimum: float, maximum: float) -> Reject | None:
    """Why this number cannot be true, if so."""
    if minimum <= number <= maximum:
        return None
    # An integer of hundreds of digits, which text can hold, is no float: it must not become one.
    if isinstance(number, float) and not math.isfinite(number):
        return Reject("not_finite", f"{key} is {number}")
    return Reject("out_of_range", f"{key} is {str(number)[:24]}; from {minimum:g} to {maximum:g}")


def bad_quaternion(quaternion: Sequence[float]) -> Reject | None:
    """Why these finite numbers are not an orientation, if so."""
    norm = math.hypot(*quaternion)
    if norm < ZERO_NORM:
        return Reject("zero_quaternion", "q is zero: no orientation")
    if abs(norm - 1) > QUATERNION_TOLERANCE:
        return Reject("unnormalised_quaternion", f"q has the norm {norm:.4g}, not 1")
    return None


def bad_variance(key: str, triangle: Sequence[float]) -> Reject | None:
    """Why these 21 numbers are the upper triangle of no covariance, if so."""
    if min(triangle[place] for place in _VARIANCES) < 0:
        return Reject("negative_variance", f"{key} has a variance below 0")
    return None


def orientation(quaternion: ArrayLike, world: World, body: Body) -> Floats:
    """map_q_base of a sender's nearly unit (w, x, y, z) from its body to its world, normalised."""
    map_q_base = orientation_to_map(quaternion, world, body)
    return np.asarray(map_q_base / math.hypot(*map_q_base.tolist()), dtype=np.float64)


def turned(rotation: Floats, numbers: Sequence[float]) -> Floats:
    """A vector (3,) in other axes."""
    return rotation @ np.array(numbers, dtype=np.float64)


def symmetric(triangle: Sequence[float]) -> Floats:
    """(6, 6) from the 21 numbers of its upper triangle, row by row."""
    return np.array(triangle, dtype=np.float64)[_PLACES]


def turned_covariance(rotation: Floats, matrix: Floats) -> Floats:
    """A covariance (6, 6) in other axes; both its blocks, linear and angular, turn alike."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    return np.asarray(both @ matrix @ both.T, dtype=np.float64)


def linear_covariance(matrix: Floats) -> Floats:
    """(6, 6) of a linear part (3, 3) alone; the angular part is unknown.

    A linear part that knows less than nothing becomes UNKNOWN_VARIANCE, so that a sender's 1e9
    does not drown the small numbers beside it.
    """
    whole = UNKNOWN_VARIANCE * np.eye(6)
    if np.diag(matrix).max() <= UNKNOWN_VARIANCE:
        whole[:3, :3] = matrix
    return whole
