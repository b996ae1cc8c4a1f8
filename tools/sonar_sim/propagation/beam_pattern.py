"""Directivity of the transducer: a shaded line array in azimuth, a short aperture in elevation."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

UNSHADED_DB = 13.2615
"""First side lobe of an unshaded aperture; no shading makes it worse."""
FAINTEST_DB = 60.0
"""Side lobes below this level are ignored."""
MAIN_LOBE_END = 2.0
"""Where a Gaussian main lobe has fallen by 61 dB and ends if no null ended it, lambda/L."""
HALF_POWER_SINC = 0.44295
"""Where sinc is 3 dB down: half the -3 dB width of an unshaded aperture, in units of lambda/L."""
LOBES_BEGIN, LOBES_FULL = 0.5, 3.0
"""Between these the side lobes of a shaded array rise out of its main lobe, lambda/L: slowly, so
that the main lobe stays Gaussian and neighbouring beams correlate as Gaussian ones do."""
EQUAL_LOBES_END = 4.2
"""Up to here the full lobes are equally high; beyond they fall by the square, as those of an
aperture without a step at its ends, lambda/L."""


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
    one_way: NDArray[np.float64] = np.square(np.sinc(stretch * sin_elevation))
    return np.square(one_way)


def azimuth_amplitude(
    width_rad: float, side_lobe_db: float
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Receive pattern of a shaded line array, one way.

    A Gaussian main lobe, as a public recording shows it, of just the width specified, and side
    lobes of which the nearest are equally high, as those of Taylor's arrays (1955): beams hear
    the level specified wherever they lie among the lobes. At 13.26 dB and above the array has no
    shading: a sinc.

    The array measures the sine of the bearing, so the pattern is a function of the sine's
    difference alone: a beam steered by b is 1 / cos(b) wider in angle.

    Args:
        width_rad: -3 dB full width at broadside.
        side_lobe_db: highest side lobe under the main lobe, positive.

    Returns:
        Function of the difference of sines, giving amplitude, 1 at 0.
    """
    stretch = HALF_POWER_SINC / math.sin(width_rad / 2.0)
    return lambda sine_difference: _shape(sine_difference * stretch, side_lobe_db)


def main_lobe_end(width_rad: float, side_lobe_db: float) -> float:
    """Difference of sines at which the main lobe of `azimuth_amplitude` ends."""
    end = _first_null(side_lobe_db)
    return end * math.sin(width_rad / 2.0) / HALF_POWER_SINC


def _shape(x: NDArray[np.float64], side_lobe_db: float) -> NDArray[np.float64]:
    """The pattern over L sin(angle) / lambda, L the length of the unshaded array as wide."""
    if side_lobe_db <= UNSHADED_DB:
        unshaded: NDArray[np.float64] = np.sinc(x)
        return unshaded
    shape: NDArray[np.float64] = np.exp2(-0.5 * np.square(x / HALF_POWER_SINC))
    if side_lobe_db >= FAINTEST_DB:
        return shape
    away = np.abs(x)
    rise = np.clip((away - LOBES_BEGIN) / (LOBES_FULL - LOBES_BEGIN), 0.0, 1.0)
    height = 10.0 ** (-side_lobe_db / 20.0) * np.square(rise) * (3.0 - 2.0 * rise)
    height *= np.square(EQUAL_LOBES_END / np.maximum(away, EQUAL_LOBES_END))
    shape += height * np.sin(np.pi * away)
    return shape


def _first_null(side_lobe_db: float) -> float:
    x = np.linspace(0.9, MAIN_LOBE_END, 1101)
    falling = np.append(_shape(x, side_lobe_db) > 0.0, [False])
    return float(x[min(int(np.argmin(falling)), len(x) - 1)])
