"""Probabilities and log-odds, and conversion of a caller's lists and arrays for the core.

The core checks shapes and that numbers are finite.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["flags_of", "log_odds_of", "numbers_of", "points_of", "probabilities_of"]

MAX_EXPONENT = 700.0
"""Limit above which exp overflows a double; its probability is 1e-304."""


def log_odds_of(probability: float, name: str) -> float:
    """Return the natural log-odds of a probability.

    Args:
        probability: strictly between 0 and 1.
        name: its name in the message.

    Raises:
        ValueError: it lies outside.
    """
    if not 0 < probability < 1:
        raise ValueError(f"{name} must lie between 0 and 1, not {probability!r}")
    return math.log(probability / (1 - probability))


def probabilities_of(log_odds: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return probabilities, float64, of log-odds of any shape."""
    exponent = np.minimum(-log_odds.astype(np.float64), MAX_EXPONENT)
    return np.asarray(1 / (1 + np.exp(exponent)), dtype=np.float64)


Floats = NDArray[np.float64]


def numbers_of(values: ArrayLike) -> Floats:
    """Return an array as float64, C order.

    Raises:
        ValueError: not an array of real numbers.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"an array of real numbers was expected, not of dtype {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64)


def points_of(points: ArrayLike) -> Floats:
    """Return points as (N, 3) float64, C order; an empty list has no points.

    Raises:
        ValueError: as `numbers_of`.
    """
    array = numbers_of(points)
    return array.reshape(0, 3) if array.shape == (0,) else array


def flags_of(flags: ArrayLike) -> NDArray[np.bool_]:
    """Return flags as (N,) bool, C order, from booleans or the integers 0 and 1.

    Raises:
        ValueError: other values, such as probabilities or NaN.
    """
    array = np.asarray(flags)
    if array.size == 0:
        return np.zeros(array.shape, dtype=np.bool_)
    if array.dtype.kind not in "biu" or array.min() < 0 or array.max() > 1:
        raise ValueError("flags must be true or false")
    return np.ascontiguousarray(array, dtype=np.bool_)
