"""Thin objects at random places: never lost, of the right level, with the spread of speckle."""

import numpy as np
import pytest
from scipy import stats
from sonar_sim.validation.thin import ThinObject, errors_db, places, speckled_powers, thin_objects

OBJECTS = pytest.mark.parametrize("thin", thin_objects(), ids=lambda thin: thin.name)


def check(thin: ThinObject, count: int, speckled: int) -> None:
    level = errors_db(thin, places(thin.sonar, count))
    assert np.abs(level).max() < 0.5
    power = speckled_powers(thin, places(thin.sonar, speckled, seed=1), first_seed=100)
    # Of an exponential distribution: mean and spread are 1.
    assert power.mean() == pytest.approx(1.0, abs=4.0 / np.sqrt(speckled))
    assert stats.kstest(power, "expon").pvalue > 1e-3


@OBJECTS
def test_thin_objects_are_never_lost(thin: ThinObject) -> None:
    check(thin, 40, 40)


@pytest.mark.slow
@OBJECTS
def test_thin_objects_are_never_lost_at_a_thousand_places(thin: ThinObject) -> None:
    check(thin, 1000, 1000)
