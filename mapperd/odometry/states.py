"""Position and attitude over time, with interpolation and extrapolation."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import quaternion_between, quaternion_product
from mapperd.odometry.series import Interpolator

__all__ = [
    "ATTITUDE",
    "HEIGHT",
    "POSITION",
    "Attitude",
    "BasePosition",
    "blend_attitude",
    "carry_attitude",
    "length",
    "turn_between",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BasePosition:
    """Position of the base.

    Attributes:
        position_m: (3,), map frame.
        velocity_mps: (3,), map frame; None if unknown.
        covariance_m2: (3, 3), map axes.
        has_height: False if only the horizontal position is known, as from a surface fix.
    """

    position_m: Floats
    velocity_mps: Floats | None
    covariance_m2: Floats
    has_height: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """Attitude of the base.

    Attributes:
        map_q_base: (4,), unit quaternion (w, x, y, z).
        rate_radps: (3,), about base axes; None if unknown.
        covariance_rad2: (3, 3), rotations about map axes.
    """

    map_q_base: Floats
    rate_radps: Floats | None
    covariance_rad2: Floats


def _blend_numbers(a: Floats, b: Floats, fraction: float) -> Floats:
    """Interpolate linearly from a to b."""
    return a + fraction * (b - a)


def _blend_position(a: BasePosition, b: BasePosition, fraction: float) -> BasePosition:
    """Interpolate linearly; the covariance is that of the worse end."""
    velocity = None
    if a.velocity_mps is not None and b.velocity_mps is not None:
        velocity = _blend_numbers(a.velocity_mps, b.velocity_mps, fraction)
    worse = a if np.trace(a.covariance_m2) >= np.trace(b.covariance_m2) else b
    return BasePosition(
        _blend_numbers(a.position_m, b.position_m, fraction),
        velocity,
        worse.covariance_m2,
        a.has_height and b.has_height,
    )


def _carry_position(position: BasePosition, seconds: float) -> BasePosition | None:
    """Extrapolate by the velocity."""
    if position.velocity_mps is None:
        return None
    moved = position.position_m + seconds * position.velocity_mps
    return BasePosition(moved, position.velocity_mps, position.covariance_m2, position.has_height)


def blend_attitude(a: Attitude, b: Attitude, fraction: float) -> Attitude:
    """Interpolate along the shorter arc at a constant rate."""
    rate = None
    if a.rate_radps is not None and b.rate_radps is not None:
        rate = _blend_numbers(a.rate_radps, b.rate_radps, fraction)
    worse = a if np.trace(a.covariance_rad2) >= np.trace(b.covariance_rad2) else b
    turned = quaternion_between(a.map_q_base, b.map_q_base, fraction)
    return Attitude(turned, rate, worse.covariance_rad2)


def carry_attitude(attitude: Attitude, seconds: float) -> Attitude | None:
    """Extrapolate by the rate."""
    if attitude.rate_radps is None:
        return None
    turned = quaternion_product(attitude.map_q_base, _rotation(attitude.rate_radps * seconds))
    return Attitude(turned / length(turned), attitude.rate_radps, attitude.covariance_rad2)


def _no_rate(value: Floats, seconds: float) -> Floats | None:  # noqa: ARG001 as every `extrapolate`
    """Return None: the rate of change is unknown."""
    return None


def length(vector: Floats) -> float:
    """Return the Euclidean norm of a vector (n,); faster than numpy's for few numbers."""
    return math.sqrt(float(vector @ vector))


def turn_between(start: Floats, end: Floats) -> Floats:
    """Return the shorter rotation vector (3,) between two attitudes, rad, base axes."""
    conjugate = start * np.array([1.0, -1.0, -1.0, -1.0])
    w, *xyz = quaternion_product(conjugate, end)
    axis = np.asarray(xyz, dtype=np.float64) * math.copysign(1.0, w)
    sine = length(axis)
    angle = 2.0 * math.atan2(sine, abs(w))
    return axis * (angle / sine if sine > 0 else 2.0)


def _rotation(vector_rad: Floats) -> Floats:
    """Return the quaternion (4,) of a rotation vector (3,)."""
    angle = length(vector_rad)
    # sin(angle/2)/angle without 0/0; numpy's sine, as in `np.sinc`, without its arrays.
    half = math.pi * (angle / (2.0 * math.pi))
    scale = 0.5 * (float(np.sin(half)) / half if half else 1.0)
    return np.array([math.cos(angle / 2.0), *(scale * vector_rad)])


POSITION = Interpolator(_blend_position, _carry_position)
ATTITUDE = Interpolator(blend_attitude, carry_attitude)
HEIGHT = Interpolator(_blend_numbers, _no_rate)
