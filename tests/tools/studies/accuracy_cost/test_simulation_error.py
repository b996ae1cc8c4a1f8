"""How pictures are compared: against numbers worked out by hand."""

import math

import numpy as np
import pytest
from sonar_sim import SonarSettings, Tolerance
from studies.accuracy_cost.simulation.error import (
    RETURN,
    beyond_tolerance,
    first_returns_m,
    picture_errors,
    rounded,
)

SONAR = SonarSettings(beams=4, forced_rows=5, demanded_range_m=1.0)


def test_half_the_amplitude_everywhere_is_an_error_of_six_decibels() -> None:
    truth = np.full((5, 4), 0.4)
    errors = picture_errors([(truth / 2.0, truth)], SONAR)
    assert errors["image_rms_db"] == pytest.approx(20.0 * math.log10(2.0))
    assert errors["image_p95_db"] == pytest.approx(20.0 * math.log10(2.0))
    assert errors["beyond_tolerance"] == 1.0


def test_quantiles_are_those_of_errors_that_differ() -> None:
    sonar = SonarSettings(beams=101, forced_rows=5, demanded_range_m=1.0)
    truth, shown = np.full((5, 101), 0.2), np.full((5, 101), 0.2)
    shown *= 10.0 ** (np.arange(101) / 2000.0)  # 0 to 1 dB in hundredths
    assert picture_errors([(shown, truth)], sonar)["image_p95_db"] == pytest.approx(0.95)
    truth, shown = np.zeros((5, 101)), np.zeros((5, 101))
    truth[1], shown[2] = 1.0, 1.0
    shown[1] = np.linspace(0.0, 0.999 * RETURN, 101)  # the threshold comes later within the row
    off_m = (RETURN - shown[1]) / (1.0 - shown[1])
    rows_m = sonar.range_resolution_m * np.sort(1.0 + off_m - RETURN)
    errors = picture_errors([(shown, truth)], sonar)
    assert errors["return_median_m"] == pytest.approx(rows_m[50])
    assert errors["return_p95_m"] == pytest.approx(rows_m[95])


def test_root_mean_square_counts_the_visible_pixels_of_all_pictures() -> None:
    truth = np.zeros((5, 4))
    truth[0] = 0.4
    off = truth.copy()
    off[0, 0] = 0.2
    # One of eight pixels is 6.02 dB off; the dark ones are no pixels.
    errors = picture_errors([(truth, truth), (off, truth)], SONAR)
    assert errors["image_rms_db"] == pytest.approx(20.0 * math.log10(2.0) / math.sqrt(8.0))


def test_an_echo_that_is_missing_is_measured_down_to_half_a_step() -> None:
    truth = np.zeros((5, 4))
    truth[2, 2] = 0.5
    errors = picture_errors([(np.zeros((5, 4)), truth)], SONAR)
    assert errors["image_rms_db"] == pytest.approx(20.0 * math.log10(0.5 / (0.5 / 255.0)))


def test_what_was_not_looked_at_is_not_compared() -> None:
    truth = np.full((5, 4), 0.4)
    shown = truth.copy()
    shown[:, 0] = np.nan
    errors = picture_errors([(shown, truth)], SONAR)
    assert errors["image_rms_db"] == 0.0
    assert errors["return_missed"] == 0.0


def test_an_edge_moved_by_less_than_half_a_cell_is_within_the_tolerance() -> None:
    edge = np.repeat([[0.01], [0.01], [0.5], [0.5], [0.5]], 4, axis=1)
    before = np.vstack([edge[1:], edge[-1:]])
    moved = {part: np.sqrt((1.0 - part) * edge**2 + part * before**2) for part in (0.4, 0.8)}
    assert not beyond_tolerance(moved[0.4], edge, SONAR, Tolerance()).any()
    assert beyond_tolerance(moved[0.8], edge, SONAR, Tolerance()).sum() == 4
    assert beyond_tolerance(moved[0.4], edge, SONAR, Tolerance(cells=0.1)).sum() == 4


def test_first_return_lies_between_the_rows_that_the_threshold_lies_between() -> None:
    beam = np.array([0.0, RETURN - 0.01, RETURN + 0.03, 1.0, 0.0])
    silent = np.full(5, RETURN / 2.0)
    found = first_returns_m(np.column_stack([beam, silent, beam, silent]), 0.2)
    # Middle of row 1 is at 0.3 m; a quarter of the way to that of row 2.
    assert found[[0, 2]] == pytest.approx(0.35)
    assert np.isnan(found[[1, 3]]).all()


def test_a_beam_that_gains_or_loses_its_return_is_missed_not_averaged() -> None:
    truth = np.zeros((5, 4))
    truth[2, :2] = 1.0
    shown = np.zeros((5, 4))
    shown[3, 1:3] = 1.0
    errors = picture_errors([(shown, truth)], SONAR)
    assert errors["return_missed"] == 0.5
    assert errors["return_median_m"] == pytest.approx(0.2)


def test_without_any_return_in_common_its_error_does_not_exist() -> None:
    errors = picture_errors([(np.full((5, 4), 0.1), np.full((5, 4), 0.1))], SONAR)
    assert math.isnan(errors["return_median_m"])
    assert math.isnan(errors["return_p95_m"])


def test_rounding_holds_what_an_integer_pixel_holds() -> None:
    gamma = SonarSettings(gamma_byte=127)
    assert rounded(np.array([0.3, 1.1]), SONAR) == pytest.approx([76 / 255, 280 / 255])
    pixel = round(255 * 0.01 ** (127 / 255))
    assert rounded(np.array([0.01]), gamma) == pytest.approx([(pixel / 255) ** (255 / 127)])
