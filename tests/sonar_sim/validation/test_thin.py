"""Thin objects at random places: never lost, of the right level, with the spread of speckle."""

import numpy as np
import pytest
from scipy import stats
from sonar_sim.scene.scene import Scene, Surface
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


def thin_rope(radius_m: float, at_m: float, lean_rad: float) -> ThinObject:
    """A round rope across the way to the sonar, 0.6 m long, that leans by an angle."""
    turn, along_m = np.arange(24) * np.pi / 12.0, np.array([-0.3, 0.3])[:, None]
    axis = np.array([0.0, np.sin(lean_rad), np.cos(lean_rad)])
    across = np.array([0.0, np.cos(lean_rad), -np.sin(lean_rad)])
    ring = radius_m * (np.cos(turn)[:, None] * [-1.0, 0.0, 0.0] + np.sin(turn)[:, None] * across)
    points = np.array([at_m, 0.0, 0.0]) + np.concatenate([ring + end * axis for end in along_m])
    low = np.arange(24)
    beside = (low + 1) % 24
    faces = np.concatenate(
        [np.stack([low, beside, beside + 24], 1), np.stack([low, beside + 24, low + 24], 1)]
    )
    middle_m = np.linspace(-0.3, 0.3, 601)
    squares = at_m**2 + middle_m**2
    # Of a thin rope: cos² over the turn gives pi / 2, the slant along it at_m² / squares.
    power = CHALK.mu * radius_m * np.pi / 2.0 * np.trapezoid(at_m**2 / squares**3, middle_m)
    sonar = SonarSettings(beams=256, demanded_range_m=at_m + 1.0, forced_rows=500)
    return ThinObject(
        "rope", Scene((Surface("rope", points, faces, CHALK, smooth=True),)), sonar, float(power)
    )


@pytest.mark.parametrize("lean_deg", [0.0, 20.0, 45.0, 70.0, 90.0])
@pytest.mark.parametrize(("radius_m", "at_m"), [(0.008, 8.0), (0.002, 9.7), (0.001, 15.0)])
def test_ropes_are_as_loud_however_they_lean(radius_m: float, at_m: float, lean_deg: float) -> None:
    thin = thin_rope(radius_m, at_m, np.radians(lean_deg))
    assert np.abs(errors_db(thin, places(thin.sonar, 12))).max() < 0.25
    power = speckled_powers(thin, places(thin.sonar, 60, seed=2), first_seed=7)
    assert power.mean() == pytest.approx(1.0, abs=4.0 / np.sqrt(60))


@pytest.mark.slow
@OBJECTS
def test_thin_objects_are_never_lost_at_a_thousand_places(thin: ThinObject) -> None:
    check(thin, 1000, 1000)
