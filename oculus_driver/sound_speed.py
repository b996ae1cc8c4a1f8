"""Speed of sound in water from temperature, salinity and depth.

C. Chen and F. Millero, "Speed of sound in seawater at high pressures", J. Acoust. Soc. Am. 62
(1977), the UNESCO equation, with the coefficients of G. Wong and S. Zhu, J. Acoust. Soc. Am. 97
(1995), for temperatures on ITS-90. Unlike Mackenzie's equation it covers fresh water. The formula
inside the sonar is not documented.
"""

from __future__ import annotations

import math
from typing import Final

from oculus_driver.errors import OutsideLimitsError

TEMPERATURE_LIMITS_C: Final = (0.0, 40.0)
SALINITY_LIMITS_PPT: Final = (0.0, 40.0)
PRESSURE_LIMITS_BAR: Final = (0.0, 1000.0)

_Table = tuple[tuple[float, ...], ...]

# Rows: powers of the pressure in bar; columns: powers of the temperature in °C.
_CW: Final[_Table] = (
    (1402.388, 5.03830, -5.81090e-2, 3.3432e-4, -1.47797e-6, 3.1419e-9),
    (0.153563, 6.8999e-4, -8.1829e-6, 1.3632e-7, -6.1260e-10),
    (3.1260e-5, -1.7111e-6, 2.5986e-8, -2.5353e-10, 1.0415e-12),
    (-9.7729e-9, 3.8513e-10, -2.3654e-12),
)
_A: Final[_Table] = (
    (1.389, -1.262e-2, 7.166e-5, 2.008e-6, -3.21e-8),
    (9.4742e-5, -1.2583e-5, -6.4928e-8, 1.0515e-8, -2.0142e-10),
    (-3.9064e-7, 9.1061e-9, -1.6009e-10, 7.994e-12),
    (1.100e-10, 6.651e-12, -3.391e-13),
)
_B: Final[_Table] = ((-1.922e-2, -4.42e-5), (7.3637e-5, 1.7950e-7))
_D: Final[_Table] = ((1.727e-3,), (-7.9836e-6,))

_FRESH_BAR_PER_M: Final = 0.0979
_SEA_BAR_PER_M: Final = 0.1008
_SEA_PPT: Final = 35.0


def speed_of_sound_mps(
    temperature_c: float, salinity_ppt: float, pressure_bar: float = 0.0
) -> float:
    """Return the speed of sound in water, m/s.

    Args:
        temperature_c: 0 to 40 °C (ITS-90).
        salinity_ppt: practical salinity, 0 to 40, about parts per thousand; 0 is fresh water.
        pressure_bar: gauge pressure of the water, without the atmosphere, 0 to 1000 bar.

    Raises:
        OutsideLimitsError: a value is outside the validity of the equation.
    """
    _check("temperature", temperature_c, TEMPERATURE_LIMITS_C, "°C")
    _check("salinity", salinity_ppt, SALINITY_LIMITS_PPT, "ppt")
    _check("pressure", pressure_bar, PRESSURE_LIMITS_BAR, "bar")
    cw, a, b, d = (_polynomial(table, temperature_c, pressure_bar) for table in (_CW, _A, _B, _D))
    return cw + (a + b * math.sqrt(salinity_ppt) + d * salinity_ppt) * salinity_ppt


def speed_of_sound_at_depth_mps(temperature_c: float, salinity_ppt: float, depth_m: float) -> float:
    """Return the speed of sound in water at a depth, m/s.

    Args:
        temperature_c: of the water at that depth, 0 to 40 °C.
        salinity_ppt: 0 to 40.
        depth_m: below the surface, not negative; see `pressure_bar_at`.

    Raises:
        OutsideLimitsError: a value is outside the validity of the equation.
    """
    pressure_bar = pressure_bar_at(depth_m, salinity_ppt)
    return speed_of_sound_mps(temperature_c, salinity_ppt, pressure_bar)


def pressure_bar_at(depth_m: float, salinity_ppt: float) -> float:
    """Return the gauge pressure of the water at a depth, bar.

    Linear in depth and salinity: 0.0979 bar/m in fresh water, 0.1008 bar/m in the sea (35 ppt). The
    compressibility of water is neglected: the true pressure of the sea is 0.3 bar higher at 1000 m,
    equivalent to 0.05 m/s of sound speed, and 3.9 bar or 0.7 m/s at 4000 m (P. Saunders, J. Phys.
    Oceanogr. 11, 1981).

    Raises:
        OutsideLimitsError: the salinity is outside 0 to 40, or the depth is negative or not finite.
    """
    _check("salinity", salinity_ppt, SALINITY_LIMITS_PPT, "ppt")
    deepest_m = PRESSURE_LIMITS_BAR[1] / _FRESH_BAR_PER_M
    _check("depth", depth_m, (0.0, deepest_m), "m")
    per_ppt = (_SEA_BAR_PER_M - _FRESH_BAR_PER_M) / _SEA_PPT
    return depth_m * (_FRESH_BAR_PER_M + per_ppt * salinity_ppt)


def _polynomial(table: _Table, temperature_c: float, pressure_bar: float) -> float:
    total = 0.0
    for row in reversed(table):
        inner = 0.0
        for coefficient in reversed(row):
            inner = inner * temperature_c + coefficient
        total = total * pressure_bar + inner
    return total


def _check(name: str, value: float, limits: tuple[float, float], unit: str) -> None:
    if not limits[0] <= value <= limits[1]:
        raise OutsideLimitsError(
            f"{name} {value:g} {unit}: the equation is valid only from {limits[0]:g} to "
            f"{limits[1]:g} {unit}"
        )
