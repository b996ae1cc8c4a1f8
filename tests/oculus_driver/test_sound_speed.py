"""Speed of sound in water."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver import (
    OutsideLimitsError,
    pressure_bar_at,
    speed_of_sound_at_depth_mps,
    speed_of_sound_mps,
)


@pytest.mark.parametrize(
    ("temperature_c", "salinity_ppt", "pressure_bar", "speed_mps"),
    [
        (4, 0, 0, 1421.6325),
        (20, 0, 0, 1482.3585),
        (22.8, 0, 0, 1490.6363),
        (10, 35, 0, 1489.8321),
        (25, 35, 0, 1534.4108),
        (10, 35, 10, 1491.4787),
        (15, 35, 50, 1514.9606),
        (2, 34, 100, 1473.2003),
        (40, 40, 1000, 1732.0175),
    ],
)
def test_the_check_values_of_the_equation_are_met(
    temperature_c: float, salinity_ppt: float, pressure_bar: float, speed_mps: float
) -> None:
    speed = speed_of_sound_mps(temperature_c, salinity_ppt, pressure_bar)
    assert speed == pytest.approx(speed_mps, abs=5e-5)


def test_the_captures_were_made_in_water_of_a_laboratory() -> None:
    # The sonar used 1490.658551 m/s with salinity 0; quirk 4: it echoes the speed that it used.
    assert speed_of_sound_mps(22.81, 0.0) == pytest.approx(1490.658551, abs=0.02)


@given(st.floats(2, 30), st.floats(25, 40), st.floats(0, 300))
def test_it_agrees_with_mackenzie_in_the_sea(t: float, s: float, d: float) -> None:
    """K. Mackenzie, J. Acoust. Soc. Am. 70 (1981); they differ most, by 0.52 m/s, at 30 °C."""
    mackenzie = (
        1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * (s - 35)
        + 1.630e-2 * d + 1.675e-7 * d**2 - 1.025e-2 * t * (s - 35) - 7.139e-13 * t * d**3
    )  # fmt: skip
    assert speed_of_sound_at_depth_mps(t, s, d) == pytest.approx(mackenzie, abs=0.55)


@given(st.floats(0, 40))
def test_it_agrees_with_marczak_in_pure_water(t: float) -> None:
    """W. Marczak, J. Acoust. Soc. Am. 102 (1997)."""
    coefficients = (
        1402.385, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9,
    )  # fmt: skip
    marczak = sum(coefficient * t**power for power, coefficient in enumerate(coefficients))
    assert speed_of_sound_mps(t, 0.0) == pytest.approx(marczak, abs=0.05)


def test_pressure_grows_with_depth_and_salt() -> None:
    assert pressure_bar_at(10, 0) == pytest.approx(0.979)
    assert pressure_bar_at(10, 35) == pytest.approx(1.008)
    assert 0.979 < pressure_bar_at(10, 17) < 1.008


@pytest.mark.parametrize(
    ("temperature_c", "salinity_ppt", "pressure_bar", "what"),
    [
        (-0.1, 35, 0, "temperature -0.1 °C"),
        (40.1, 35, 0, "temperature 40.1 °C"),
        (10, -1, 0, "salinity -1 ppt"),
        (10, 41, 0, "salinity 41 ppt"),
        (10, 35, -0.1, "pressure -0.1 bar"),
        (10, 35, 1001, "pressure 1001 bar"),
        (math.nan, 35, 0, "temperature nan"),
    ],
)
def test_nothing_is_guessed_outside_the_limits(
    temperature_c: float, salinity_ppt: float, pressure_bar: float, what: str
) -> None:
    with pytest.raises(OutsideLimitsError, match=what):
        speed_of_sound_mps(temperature_c, salinity_ppt, pressure_bar)


@pytest.mark.parametrize("depth_m", [-1.0, 20_000.0, math.inf, math.nan])
def test_no_sonar_works_there(depth_m: float) -> None:
    with pytest.raises(OutsideLimitsError, match="depth"):
        speed_of_sound_at_depth_mps(10, 35, depth_m)


def test_the_limits_themselves_are_inside() -> None:
    assert speed_of_sound_mps(0, 0, 0) == pytest.approx(1402.388)
    assert math.isfinite(speed_of_sound_mps(40, 40, 1000))
