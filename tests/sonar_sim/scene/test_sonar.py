import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene.sonar import SonarSettings, sonar_preset

from oculus_driver.models import FAMILIES

PRESETS = [
    (model, mode)
    for model in ("M370s", "M750d", "M1200d", "M3000d")
    for mode in (1, 2)
    if (model, mode) != ("M370s", 2)
]


@pytest.mark.parametrize(("model", "mode"), PRESETS)
def test_presets_are_the_drivers_models(model: str, mode: int) -> None:
    known = next(f for f in FAMILIES if f.name == model).modes[mode - 1]
    sonar = sonar_preset(model, mode)
    assert sonar.frequency_hz == pytest.approx(known.frequency_hz)
    assert sonar.max_range_m == known.max_range_m
    assert (sonar.model, sonar.mode) == (model, mode)
    expected_deg = (known.aperture_deg or 130.0, known.resolution_deg or 2.0)
    found_rad = (2.0 * sonar.half_aperture_rad, sonar.beam_width_rad)
    assert np.degrees(found_rad) == pytest.approx(expected_deg)


def test_bands_have_the_published_beams() -> None:
    """Nobody publishes the M370s' own."""
    low, high = sonar_preset("M750d", 1), sonar_preset("M750d", 2)
    assert np.degrees([low.beam_width_rad, high.beam_width_rad]) == pytest.approx([1.0, 0.6])
    assert (low.base_row_m, high.base_row_m) == (0.004, 0.0025)


def test_preset_of_the_default_is_the_default() -> None:
    assert sonar_preset() == SonarSettings()
    assert sonar_preset("M750d", 1, beams=256).beams == 256


def test_rows_follow_the_range_as_an_oculus_chooses_them_unless_forced() -> None:
    assert sonar_preset(demanded_range_m=2.0).rows == 500
    assert sonar_preset(demanded_range_m=10.0).range_resolution_m == 0.016
    forced = sonar_preset(demanded_range_m=20.0, forced_rows=1000)
    assert forced.rows == 1000
    assert forced.range_resolution_m == pytest.approx(0.02)
    assert forced.range_m == pytest.approx(20.0)
    assert forced.row_centres_m[[0, -1]] == pytest.approx([0.01, 19.99])


@pytest.mark.parametrize("max_rows", [1, 2, 3, 720])
@pytest.mark.parametrize("rows", [1.0, 1.5, 2.0, 2.5, 4.0, 7.9, 8.1, 1500.0])
def test_rows_are_coarsened_to_at_least_one_and_at_most_max_rows(
    max_rows: int, rows: float
) -> None:
    sonar = SonarSettings(
        base_row_m=0.1, demanded_range_m=0.1 * rows, max_range_m=200.0, max_rows=max_rows
    )
    assert 1 <= sonar.rows <= max_rows


@pytest.mark.parametrize(
    ("model", "mode", "changes", "word"),
    [
        ("M750d", 3, {}, "there are M370s mode 1"),
        ("M999", 1, {}, "no M999"),
        ("Ping360", 1, {}, "a Ping360 is a sonar_sim.ScanningSonar"),
        ("M750d", 2, {"demanded_range_m": 41.0}, "0.1 to 40 m"),
        ("M750d", 1, {"demanded_range_m": 0.05}, "0.1 to 120 m"),
        ("M750d", 1, {"bits": 24}, "24 bits"),
        ("M750d", 1, {"forced_rows": 0}, "no image"),
        ("M750d", 1, {"demanded_range_m": 0.5, "base_row_m": 1.0}, "demanded_range_m .*base_row_m"),
    ],
)
def test_what_no_sonar_can_is_refused(
    model: str, mode: int, changes: dict[str, float], word: str
) -> None:
    with pytest.raises(SceneError, match=word):
        sonar_preset(model, mode, **changes)


NUMBERS = [field.name for field in fields(SonarSettings) if field.name not in ("model", "mode")]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", NUMBERS)
def test_every_number_of_a_sonar_is_finite(name: str, value: float) -> None:
    change: dict[str, Any] = {name: value}
    with pytest.raises(SceneError, match=f"^{name} "):
        replace(SonarSettings(), **change)


@pytest.mark.parametrize("value", [0.0, -1.0])
@pytest.mark.parametrize(
    "name",
    [
        "frequency_hz",
        "half_aperture_rad",
        "beam_width_rad",
        "vertical_width_rad",
        "base_row_m",
        "max_range_m",
        "told_speed_mps",
        "pulse_s",
    ],
)
def test_what_is_divided_by_is_more_than_0(name: str, value: float) -> None:
    change: dict[str, Any] = {name: value}
    with pytest.raises(SceneError, match=f"^{name} .*more than 0"):
        replace(SonarSettings(), **change)


@pytest.mark.parametrize(
    ("model", "published"),
    [  # kHz, beams, swath in degrees, range resolution and longest range in m
        ("Gemini 720is", (720.0, 512, 120.0, 0.008, 120.0)),
        ("P900-45", (900.0, 256, 45.0, 0.0254, 100.0)),
        ("P900-90", (900.0, 512, 90.0, 0.0254, 100.0)),
        ("P900-130", (900.0, 768, 130.0, 0.0254, 100.0)),
    ],
)
def test_sonars_of_other_makers_are_their_data_sheets(
    model: str, published: tuple[float, int, float, float, float]
) -> None:
    khz, beams, aperture_deg, row_m, max_range_m = published
    sonar = sonar_preset(model, demanded_range_m=max_range_m / 4)
    assert (sonar.frequency_hz, sonar.beams) == (1e3 * khz, beams)
    assert np.degrees(2.0 * sonar.half_aperture_rad) == pytest.approx(aperture_deg)
    angles_deg = np.degrees([sonar.beam_width_rad, sonar.vertical_width_rad])
    assert angles_deg == pytest.approx([1.0, 20.0])
    assert sonar.range_resolution_m == row_m, "an Oculus would coarsen it"
    assert sonar.max_range_m == max_range_m
    assert not sonar.on_wire
    assert sonar_preset("M1200d").on_wire
    with pytest.raises(SceneError, match=f"no {model} with mode 2"):
        sonar_preset(model, 2)
