"""Numbers from the wire, checked and turned into our frames: what all formats share."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.geometry.frames import Body, World, orientation_to_map
from mapperd.odometry.records import UNKNOWN_VARIANCE
from mapperd.reject import Reject

__all__ = [
    "MAX_COVARIANCE",
    "MAX_DEPTH_M",
    "MAX_DISTANCE_M",
    "MAX_RATE_RADPS",
    "MAX_SPEED_MPS",
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

Floats = NDArray[np.float64]

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


def bad_number(key: str, number: float, least: float, most: float) -> Reject | None:
    """Why this number cannot be true, if so."""
    if least <= number <= most:
        return None
    # An integer of hundreds of digits, which text can hold, is no float: it must not become one.
    if isinstance(number, float) and not math.isfinite(number):
        return Reject("not_finite", f"{key} is {number}")
    return Reject("out_of_range", f"{key} is {str(number)[:24]}; from {least:g} to {most:g}")


def bad_quaternion(quaternion: Sequence[float]) -> Reject | None:
    """Why these finite numbers are no orientation, if so."""
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
