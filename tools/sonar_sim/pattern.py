"""Directivity of the transducer: a shaded line array in azimuth, a short aperture in elevation."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

LEVELLED_LOBES = 4
"""Taylor's n-bar: side lobes kept at the design level before they begin to fall."""
HALF_POWER_SINC = 0.44295
"""Where sinc is 3 dB down: half the -3 dB width of an unshaded aperture, in units of lambda/L."""


def vertical_two_way_power(
    sin_elevation: NDArray[np.float64], width_rad: float
) -> NDArray[np.float64]:
    """Power that the vertical pattern leaves to an echo, transmit times receive.

    An unshaded aperture: sinc² each way.

    Args:
        sin_elevation: sine of the elevation above the fan's plane, any shape.
        width_rad: one-way -3 dB full width.

    Returns:
        Factor, 1 on the axis.
    """
    stretch = HALF_POWER_SINC / math.sin(width_rad / 2.0)
    power: NDArray[np.float64] = np.sinc(stretch * sin_elevation) ** 4
    return power


def azimuth_amplitude(
    width_rad: float, side_lobe_db: float
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Receive pattern of a Taylor-shaded line array, one way.

    The array measures the sine of the bearing, so the pattern is a function of the sine's
    difference alone: a beam steered by b is 1 / cos(b) wider in angle.

    Args:
        width_rad: -3 dB full width at broadside.
        side_lobe_db: design level of the side lobes, positive.

    Returns:
        Function of the difference of sines, giving amplitude, 1 at 0.
    """
    shape = _taylor(side_lobe_db)
    half_power = brentq(lambda x: float(shape(np.array(x))) - math.sqrt(0.5), 0.1, 1.2)
    stretch = half_power / math.sin(width_rad / 2.0)
    return lambda sine_difference: shape(sine_difference * stretch)


def _taylor(side_lobe_db: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Taylor's pattern (1955) over L sin(angle) / lambda, by the product of its zeros."""
    a2 = (math.acosh(10.0 ** (side_lobe_db / 20.0)) / math.pi) ** 2
    dilation = LEVELLED_LOBES**2 / (a2 + (LEVELLED_LOBES - 0.5) ** 2)

    def shape(x: NDArray[np.float64]) -> NDArray[np.float64]:
        x2 = np.square(x)
        value: NDArray[np.float64] = np.sinc(x)
        for m in range(1, LEVELLED_LOBES):
            moved_zero = dilation * (a2 + (m - 0.5) ** 2)
            # sinc's own zero at m goes out against the denominator: keep off the 0/0.
            removed = 1.0 - x2 / m**2
            removed = np.where(np.abs(removed) < 1e-9, 1e-9, removed)  # noqa: PLR2004
            value = value * (1.0 - x2 / moved_zero) / removed
        return value

    return shape
