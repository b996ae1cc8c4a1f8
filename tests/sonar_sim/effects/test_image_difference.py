"""How much two pictures differ: level, displacement, grain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.effects.image_difference import (
    DARK_WEIGHT,
    expected_clipped,
    level_change_db,
    quantiser_change_db,
)
from sonar_sim.effects.texture import displacement_cells, speckle_texture, texture_change
from sonar_sim.scene.sonar import SonarSettings

SONAR = SonarSettings(bits=16)
RNG = np.random.default_rng(4)
FLAT = np.full((96, 96), 0.1, dtype=np.float32)


def speckle(seed: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    field = rng.standard_normal((128, 128)) + 1j * rng.standard_normal((128, 128))
    smooth = field + 0.6 * np.roll(field, 1, axis=0) + 0.6 * np.roll(field, 1, axis=1)
    amplitude = np.abs(smooth)
    mean = np.sqrt(np.mean(amplitude**2))
    shown: NDArray[np.float32] = (0.01 * amplitude / mean).astype(np.float32)
    return shown


def test_a_factor_of_two_is_six_decibels() -> None:
    assert level_change_db(FLAT, 2 * FLAT, SONAR, 0.0) == pytest.approx(6.02, abs=0.01)


def test_a_share_of_the_pixels_may_differ() -> None:
    spot = FLAT.copy()
    spot[3, 3] = 1.0
    assert level_change_db(FLAT, spot, SONAR, 0.0) == pytest.approx(20.0, abs=0.01)
    assert level_change_db(FLAT, spot, SONAR, 0.001) == 0.0


def with_dark(amplitude: float) -> np.ndarray:
    """Bright but for two of ten columns: too few for their mean to be looked at."""
    picture = np.full((10, 10), 0.5, dtype=np.float32)
    picture[:, :2] = amplitude
    return picture


def test_less_than_a_step_is_not_seen_in_single_pixels() -> None:
    coarse, dark = replace(SONAR, bits=8), with_dark(1.0 / 255.0)
    assert level_change_db(dark, with_dark(1.9 / 255.0), coarse, 0.0) == 0.0
    brighter = level_change_db(dark, with_dark(2.5 / 255.0), coarse, 0.0)
    assert brighter == pytest.approx(7.96, abs=0.01)


def test_gamma_makes_steps_of_dark_pixels_finer() -> None:
    linear = replace(SONAR, bits=8)
    curved = replace(linear, gamma_byte=127)
    assert level_change_db(with_dark(1e-3), with_dark(2e-3), linear, 0.0) == 0.0
    change_db = level_change_db(with_dark(1e-3), with_dark(2e-3), curved, 0.0)
    assert change_db == pytest.approx(6.02, abs=0.01)


@pytest.mark.parametrize("gamma_byte", [127, 255])
@pytest.mark.parametrize("steps", [0.5, 0.9, 1.4])
def test_what_fills_the_dark_is_seen_in_the_mean_of_its_pixels(
    steps: float, gamma_byte: int
) -> None:
    """Against the pixels of a million speckles."""
    sonar = replace(SONAR, bits=8, gamma_byte=gamma_byte)
    gamma = 1.0 if gamma_byte == 255 else gamma_byte / 255.0
    rms = [(part * steps / 255.0) ** (1.0 / gamma) for part in (1.0, 1.2)]
    field = np.random.default_rng(26).normal(size=(2, 500_000)) / math.sqrt(2.0)
    speckle = np.hypot(*field)
    means = [np.rint(255.0 * (speckle * m) ** gamma).mean() for m in rms]
    expected_db = DARK_WEIGHT * 20.0 / gamma * math.log10(means[1] / means[0])
    one, other = (np.full((64, 8), m, dtype=np.float32) for m in rms)
    assert level_change_db(one, other, sonar, 0.001) == pytest.approx(expected_db, rel=0.03)


def test_dark_pixels_that_stay_black_do_not_differ() -> None:
    one, other = (np.full((64, 8), m / 255.0, dtype=np.float32) for m in (0.05, 0.2))
    assert level_change_db(one, other, replace(SONAR, bits=8), 0.001) == 0.0


@pytest.mark.parametrize(("cells", "same"), [(0.5, True), (0.2, False)])
def test_a_small_displacement_is_no_change_of_level(cells: float, *, same: bool) -> None:
    # A gentle slope: displacing blurs a sharp edge, which then counts as a change.
    rows = np.arange(96, dtype=np.float32)
    slope = (0.1 + 0.01 * rows)[:, None] * np.ones(96, dtype=np.float32)
    moved = slope + np.float32(0.005)
    moved[-1] = slope[-1]
    assert (level_change_db(slope, moved, SONAR, 0.0, (cells, cells)) < 0.01) is same


def test_a_displacement_along_one_axis_explains_nothing_along_the_other() -> None:
    slope = np.repeat(np.linspace(0.1, 0.5, 64, dtype=np.float32)[:, None], 64, axis=1)
    moved = np.roll(slope, 1, axis=0)
    moved[0] = slope[0]
    assert level_change_db(slope, moved, SONAR, 0.0, (1.0, 0.0)) < 0.01
    assert level_change_db(slope, moved, SONAR, 0.0, (0.0, 1.0)) > 0.1


def test_a_new_thing_is_found_whichever_picture_has_it() -> None:
    spot = FLAT.copy()
    spot[30:40, 30:40] = 0.5
    for pair in ((FLAT, spot), (spot, FLAT)):
        assert level_change_db(*pair, SONAR, 0.001, (0.5, 0.5)) == pytest.approx(13.98, abs=0.01)


def test_rounding_shows_in_the_dark() -> None:
    ramp = np.linspace(0.0, 0.1, 10000)
    assert quantiser_change_db(ramp, replace(SONAR, bits=8), 0.001) == pytest.approx(5.59, abs=0.06)
    assert quantiser_change_db(ramp, replace(SONAR, bits=32), 0.001) < 0.01


@pytest.mark.parametrize(("rows", "beams"), [(0, 0), (1, 0), (0, 2), (3, 3)])
def test_speckle_shows_where_it_went(rows: int, beams: int) -> None:
    expected = np.full((128, 128), 0.01, dtype=np.float32)
    picture = speckle(1)
    moved = np.roll(picture, (rows, beams), axis=(0, 1))
    first, second = (speckle_texture(p, expected, SONAR) for p in (picture, moved))
    assert displacement_cells(first, second) == pytest.approx(max(rows, beams), abs=0.15)


def test_grain_drawn_again_is_neither_displaced_nor_of_another_kind() -> None:
    expected = np.full((128, 128), 0.01, dtype=np.float32)
    first, second = (speckle_texture(speckle(seed), expected, SONAR) for seed in (1, 2))
    assert displacement_cells(first, second) is None
    assert texture_change(first, second) < 0.05


def test_grain_and_its_correlation_are_texture() -> None:
    expected = np.full((128, 128), 0.01, dtype=np.float32)
    grained = speckle_texture(speckle(1), expected, SONAR)
    smooth = speckle_texture(expected, expected, SONAR)
    shuffled = RNG.permuted(speckle(1), axis=0)
    assert grained.statistics[0] == pytest.approx(0.52, abs=0.02)
    assert texture_change(grained, smooth) > 0.5
    assert texture_change(grained, speckle_texture(shuffled, expected, SONAR)) > 0.08


def test_grain_is_compared_where_both_show_some() -> None:
    expected = np.full((128, 128), 0.01, dtype=np.float32)
    dark = expected.copy()
    dark[:, 64:] = 1e-6
    grained = speckle(1)
    # What only the first shows is of another kind, and would count if it were looked at.
    first = grained.copy()
    first[:, 64:] = expected[:, 64:]
    pair = speckle_texture(first, expected, SONAR), speckle_texture(grained, dark, SONAR)
    assert texture_change(*pair) < 0.01


def test_a_third_of_a_block_shows_where_it_went() -> None:
    expected = np.full((96, 96), 1e-6, dtype=np.float32)
    expected[10::48, :] = expected[11::48, :] = 0.01
    for row in range(12, 28):
        expected[row::48, :] = 0.01
    picture = speckle(1)[:96, :96]
    first = speckle_texture(picture, expected, SONAR)
    second = speckle_texture(np.roll(picture, 2, axis=1), expected, SONAR)
    assert displacement_cells(first, second) == pytest.approx(2.0, abs=0.2)


def test_speckle_that_is_clipped_is_expected_lower_before_its_mean_is() -> None:
    random = np.random.default_rng(3)
    for rms in (0.3, 0.8, 1.0, 2.0):
        speckle = rms * np.sqrt(random.exponential(size=400_000))
        kept = np.minimum(speckle, 1.0).mean() / speckle.mean()
        got = float(expected_clipped(np.array([rms]))[0])
        assert got == pytest.approx(rms * kept, rel=5e-3)
