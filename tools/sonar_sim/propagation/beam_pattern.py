"""Directivity of the transducer: a shaded line array in azimuth, a short aperture in elevation."""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

UNSHADED_DB = 13.2615
"""First side lobe of an unshaded aperture; no shading makes it worse."""
FAINTEST_DB = 60.0
"""Side lobes below this level are ignored."""
MAIN_LOBE_END = 2.0
"""Where a Gaussian main lobe has fallen by 61 dB and ends if no null ended it, lambda/L."""
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
    """Receive pattern of a shaded line array, one way.

    The shading is a Gaussian on a pedestal, so the pattern is a Gaussian plus a little of an
    unshaded aperture's sinc, both of the same width: a public recording shows a Gaussian beam of
    just the width specified. At 13.26 dB the pedestal is all there is.

    The array measures the sine of the bearing, so the pattern is a function of the sine's
    difference alone: a beam steered by b is 1 / cos(b) wider in angle.

    Args:
        width_rad: -3 dB full width at broadside.
        side_lobe_db: highest side lobe under the main lobe, positive.

    Returns:
        Function of the difference of sines, giving amplitude, 1 at 0.
    """
    pedestal = _pedestal(side_lobe_db)
    stretch = HALF_POWER_SINC / math.sin(width_rad / 2.0)
    return lambda sine_difference: _shape(sine_difference * stretch, pedestal)


def main_lobe_end(width_rad: float, side_lobe_db: float) -> float:
    """Difference of sines at which the main lobe of `azimuth_amplitude` ends."""
    end = _first_null(_pedestal(side_lobe_db))
    return end * math.sin(width_rad / 2.0) / HALF_POWER_SINC


def _shape(x: NDArray[np.float64], pedestal: float) -> NDArray[np.float64]:
    """The pattern over L sin(angle) / lambda, L the length of the unshaded array as wide."""
    gaussian = np.exp2(-0.5 * np.square(x / HALF_POWER_SINC))
    shape: NDArray[np.float64] = (1.0 - pedestal) * gaussian + pedestal * np.sinc(x)
    return shape


def _first_null(pedestal: float) -> float:
    x = np.linspace(0.9, MAIN_LOBE_END, 1101)
    falling = np.append(_shape(x, pedestal) > 0.0, [False])
    return float(x[min(int(np.argmin(falling)), len(x) - 1)])


@lru_cache(maxsize=64)
def _pedestal(side_lobe_db: float) -> float:
    """Part of the pedestal in the pattern's peak that gives the highest side lobe."""
    if side_lobe_db <= UNSHADED_DB:
        return 1.0
    if side_lobe_db >= FAINTEST_DB:
        return 0.0

    def excess_db(log_pedestal: float) -> float:
        pedestal = 10.0**log_pedestal
        lobes = _shape(np.linspace(_first_null(pedestal), 5.0, 2001), pedestal)
        return float(20.0 * np.log10(np.abs(lobes).max()) + side_lobe_db)

    return float(10.0 ** brentq(excess_db, -6.0, 0.0))
