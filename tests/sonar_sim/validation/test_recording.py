"""The simulated sonar is like the recorded one: M1200d, 2.1 MHz, three pings from one pose."""

from pathlib import Path

import numpy as np
import pytest
from sonar_sim.validation.alike import RecordingComparison, compare
from sonar_sim.validation.recording import (
    Recorded,
    band_centres_m,
    noise_level_db,
    noisy_bands,
    read_recording,
    simulate_floor,
    simulate_recording,
    usual_floor_db,
)
from sonar_sim.validation.statistics import linear_amplitude, ping_correlation

NUMBERS = 25


@pytest.fixture(scope="module")
def recorded(shared_data: Path) -> Recorded:
    return read_recording(shared_data / "oculus" / "three_pings_8bit.raw")


@pytest.fixture(scope="module")
def numbers(recorded: Recorded) -> tuple[RecordingComparison, ...]:
    return compare(recorded, simulate_recording(recorded))


def test_header_gives_the_sonar(recorded: Recorded) -> None:
    sonar = recorded.sonar
    assert recorded.pixels.shape == (3, sonar.rows, sonar.beams) == (3, 703, 256)
    assert sonar.range_resolution_m == pytest.approx(2.842e-3, abs=1e-6)
    assert (sonar.gamma_byte, sonar.gain_percent) == (127, 50.0)


def test_every_number_of_the_simulation_is_near_the_recordings(
    numbers: tuple[RecordingComparison, ...],
) -> None:
    assert len(numbers) == NUMBERS
    assert [number for number in numbers if not number.holds] == []


def test_both_are_near_the_reference(numbers: tuple[RecordingComparison, ...]) -> None:
    compared = [number for number in numbers if number.reference is not None]
    assert compared
    for number in compared:
        assert number.reference is not None
        # The reference gives about 30 dB, without echoes under the noise.
        most = 4.0 if number.what.endswith("dB") else number.tolerance
        assert abs(number.real - number.reference) <= most, number
        assert abs(number.simulated - number.reference) <= most, number


def test_floor_follows_the_usual_law_of_the_varied_gain(recorded: Recorded) -> None:
    noisy = noisy_bands(recorded.sonar)
    assert noisy.sum() >= 12
    level_db = noise_level_db(recorded.pixels, recorded.sonar.gamma_byte)
    off = (level_db - usual_floor_db(recorded))[noisy]
    assert np.abs(off).max() < 5.0
    assert band_centres_m(recorded.sonar)[noisy].min() < 0.3


def test_simulation_is_the_same_each_time_and_another_with_another_seed(
    recorded: Recorded,
) -> None:
    once, again, other = (simulate_recording(recorded, 1, seed) for seed in (0, 0, 1))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)


BANDS = (
    ("silent", 0.15, 0.4, 0.1),
    ("floor", 0.8, 1.1, 0.03),
    ("tail", 1.45, 1.6, 0.2),
    ("dark", 1.65, 2.0, 0.15),
)
"""Ranges, m, and how near the correlation between pings must be."""


def test_a_floor_in_a_scene_is_like_the_recorded_one(recorded: Recorded) -> None:
    """All of the simulator, by default: noise, floor, tail and what stays from ping to ping."""
    both = (recorded.pixels, simulate_floor(recorded))
    amplitudes = [linear_amplitude(pixels, recorded.sonar.gamma_byte) for pixels in both]
    range_m = recorded.sonar.row_centres_m
    for name, low_m, high_m, tolerance in BANDS:
        rows = (range_m > low_m) & (range_m < high_m)
        real, simulated = (ping_correlation([a[rows] for a in pings]) for pings in amplitudes)
        assert simulated == pytest.approx(real, abs=tolerance), name
        levels = [10.0 * np.log10(np.mean(np.square(pings[:, rows]))) for pings in amplitudes]
        if name != "silent":  # There the recorded gain stops to fall towards the sonar.
            assert levels[1] == pytest.approx(levels[0], abs=5.0), name
