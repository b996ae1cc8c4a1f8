"""Medians of counted whole numbers are those of the numbers."""

import numpy as np
import pytest
from mapper_survey.tally import Tally


@pytest.mark.parametrize("size", [1, 2, 3, 20, 101])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 1.0])
def test_quantiles_are_those_of_the_numbers(size: int, share: float) -> None:
    numbers = np.random.default_rng(size).integers(-9, 9, size)
    tally = Tally()
    tally.add(numbers[: size // 2])
    tally.add(numbers[size // 2 :])
    assert tally.quantile(share) == np.quantile(numbers, share, method="inverted_cdf")
    assert (len(tally), tally.up_to(3)) == (size, (numbers <= 3).sum())


def test_nothing_has_no_median() -> None:
    assert Tally().quantile(0.5) is None
