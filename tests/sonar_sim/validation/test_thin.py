"""Thin objects at random places: never lost, of the right level, with the spread of speckle."""

import numpy as np
import pytest
from scipy import stats
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.setups import CHALK, rectangle
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


@pytest.mark.parametrize(
    ("at_m", "wide_m", "pitch_m"),
    [(10.0, 0.001, 0.006), (10.0, 0.002, 0.012), (30.0, 0.003, 0.015), (30.0, 0.004, 0.03)],
)
def test_nets_are_as_loud_as_all_of_their_bars(at_m: float, wide_m: float, pitch_m: float) -> None:
    """Dozens of bars within one cell of the rays: none is counted twice, none is left out."""
    aside_m = pitch_m * (np.arange(60) - 29.5)
    bars = [
        rectangle((at_m, aside, 0.0), (0.0, wide_m, 0.0), (0.0, 0.0, 1.0), CHALK)
        for aside in aside_m
    ]
    up_m = np.linspace(-0.5, 0.5, 201)
    squares = at_m**2 + aside_m[:, None] ** 2 + up_m**2
    power = CHALK.mu * wide_m * np.trapezoid(at_m**2 / squares**3, up_m).sum()
    sonar = SonarSettings(beams=256, demanded_range_m=at_m + 1.0, forced_rows=500)
    level = errors_db(ThinObject("net", Scene(tuple(bars)), sonar, float(power)), places(sonar, 12))
    assert np.abs(level).max() < 0.5


@pytest.mark.slow
@OBJECTS
def test_thin_objects_are_never_lost_at_a_thousand_places(thin: ThinObject) -> None:
    check(thin, 1000, 1000)
