"""How grain is measured: laws that are known, and samples whose chance is known."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from studies.accuracy_cost.simulation.error import Grain, grain_errors, grain_of, kept_grain


def speckle_db(seed: int, rows: int, leak: float = 0.0) -> NDArray[np.float64]:
    """Level of fully developed speckle, of which a part leaks into the next rows."""
    rng = np.random.default_rng(seed)
    field = rng.normal(size=(rows + 2, 40)) + 1j * rng.normal(size=(rows + 2, 40))
    mixed = field[1:-1] + leak * (field[:-2] + field[2:])
    return np.asarray(20.0 * np.log10(np.abs(mixed)), dtype=np.float64)


def test_rayleigh_grain_spreads_by_its_law_and_leaks_into_the_next_row() -> None:
    leak = 0.26
    grain = grain_of([speckle_db(seed, 1000, leak) for seed in range(10)])
    assert grain.spread_db == pytest.approx(5.57, abs=0.03)
    # The correlation of Rayleigh amplitudes is nearly that of their powers, which is the square
    # of their fields'.
    of_fields = 2.0 * leak / (1.0 + 2.0 * leak**2)
    assert grain.row_correlation == pytest.approx(of_fields**2, abs=0.02)


def test_rows_of_two_pictures_are_no_neighbours() -> None:
    low, high = np.full((1, 4), -6.0), np.full((1, 4), 6.0)
    assert math.isnan(grain_of([low, high, low, high]).row_correlation)


def test_pictures_are_one_sample_about_the_expected_level() -> None:
    loud, faint = np.full((5, 4), 2.0), np.full((5, 4), -2.0)
    grain = grain_of([loud, faint])
    assert grain.spread_db == pytest.approx(2.0)  # each by itself has none


def test_chance_is_what_other_samples_differ_by() -> None:
    samples = [grain_of([speckle_db(16 * k + s, 30) for s in range(16)]) for k in range(40)]
    for reported, figure in (
        ("spread_chance_db", "spread_db"),
        ("correlation_chance", "row_correlation"),
    ):
        found = np.std([getattr(grain, figure) for grain in samples])
        stated = np.mean([getattr(grain, reported) for grain in samples])
        assert stated == pytest.approx(found, rel=0.3), figure
    alone = grain_of([speckle_db(1, 30)])
    assert math.isnan(alone.spread_chance_db)
    assert math.isnan(alone.correlation_chance)


def test_a_picture_without_grain_lacks_all_of_it() -> None:
    even = grain_of([np.zeros((5, 4)), np.zeros((5, 4))])
    assert grain_errors(even, Grain(5.57, 0.19, 0.03, 0.02)) == {
        "grain_spread_db": 5.57,
        "grain_spread_chance_db": 0.03,
        "grain_correlation": 0.19,
        "grain_correlation_chance": 0.02,
    }


def test_chances_of_both_add_as_those_of_independent_samples_do() -> None:
    errors = grain_errors(Grain(5.6, 0.2, 0.03, 0.3), Grain(5.5, 0.2, 0.04, 0.4))
    assert errors["grain_spread_chance_db"] == pytest.approx(0.05)
    assert errors["grain_correlation_chance"] == pytest.approx(0.5)


def test_grain_of_pictures_that_show_nothing_does_not_exist() -> None:
    nothing = grain_of([np.full((5, 4), np.nan)] * 2)
    assert all(math.isnan(value) for value in grain_errors(nothing, nothing).values())


def test_a_grain_is_measured_once(tmp_path: Path) -> None:
    path, made = tmp_path / "grain.npy", list[int]()

    def measure() -> Grain:
        made.append(1)
        return Grain(5.5, 0.25, 0.125, 0.5)

    assert kept_grain(path, measure) == kept_grain(path, measure) == Grain(5.5, 0.25, 0.125, 0.5)
    assert made == [1]
    assert list(tmp_path.iterdir()) == [path]
