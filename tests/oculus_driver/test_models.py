"""Part numbers and what they stand for."""

from __future__ import annotations

import pytest

from oculus_driver.models import (
    C550D,
    FAMILIES,
    M370S,
    M750D,
    M1200D,
    M3000D,
    MAX_RATE_HZ,
    MODELS,
    UNKNOWN,
    Family,
    max_rate_hz,
    model_of,
)
from oculus_driver.wire import PingRate


@pytest.mark.parametrize(
    ("part_number", "name", "family"),
    [
        (1032, "M750d", M750D),
        (1042, "M1200d", M1200D),
        (1041, "M370s", M370S),
        (2203, "M3000d", M3000D),
        (4713, "C550d", C550D),
        (0, "part 0", UNKNOWN),
        (65535, "part 65535", UNKNOWN),
    ],
)
def test_a_part_number_has_a_model(part_number: int, name: str, family: Family) -> None:
    model = model_of(part_number)
    assert (model.part_number, model.name, model.family) == (part_number, name, family)


def test_the_m370s_has_one_mode() -> None:
    assert M370S.max_range_m == (200.0, None)


def test_the_beam_of_the_m750d_depends_on_when_it_was_made() -> None:
    # quirk 35: nothing in the stream distinguishes them
    assert M750D.modes[1].elevation_deg == (12.0, 20.0)


def test_mode_2_looks_less_far_and_less_wide_everywhere() -> None:
    for family in FAMILIES:
        if len(family.modes) > 1:
            wide, narrow = family.modes
            assert narrow.max_range_m < wide.max_range_m
            assert (narrow.aperture_deg or 0.0) <= (wide.aperture_deg or 0.0)
            assert (narrow.frequency_hz or 0.0) >= (wide.frequency_hz or 0.0)


def test_every_model_has_a_family_that_is_listed() -> None:
    assert {model.family for model in MODELS.values()} == set(FAMILIES)
    assert all(model_of(number) is model for number, model in MODELS.items())


@pytest.mark.parametrize(
    ("rate", "range_m", "hertz"),
    [
        (PingRate.HIGHEST, 5.0, 40.0),
        (PingRate.HIGHEST, 30.0, 25.0),
        (PingRate.HIGHEST, 120.0, 6.25),
        (PingRate.NORMAL, 30.0, 10.0),
        (PingRate.LOWEST, 120.0, 2.0),
        (PingRate.STANDBY, 1.0, 0.0),
    ],
)
def test_pings_come_as_fast_as_setting_and_sound_allow(
    rate: PingRate, range_m: float, hertz: float
) -> None:
    assert max_rate_hz(rate, range_m) == pytest.approx(hertz)


def test_every_ping_rate_has_a_limit() -> None:
    assert set(MAX_RATE_HZ) == set(PingRate)
