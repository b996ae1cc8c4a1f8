import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from sonar_sim.propagation.beam_pattern import (
    azimuth_amplitude,
    main_lobe_end,
    vertical_two_way_power,
)
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.fan import MARGIN_BEAMS
from sonar_sim.receiver.beamformer import beam_former
from sonar_sim.scene.sonar import SonarSettings

SONAR = SonarSettings()
BEAMS = Physics(
    beam_width_rad=SONAR.beam_width_rad,
    side_lobe_db=SONAR.side_lobe_db,
    range_spread=True,
    sine_bearings=True,
)


def formed(field: NDArray[np.complex64]) -> NDArray[np.float32]:
    beams: NDArray[np.float32] = np.abs(beam_former(SONAR, BEAMS, MARGIN_BEAMS).form(field, 1))
    return beams


@pytest.mark.parametrize(
    ("elevation_deg", "loss_db"),
    [(2, 0.2), (5, 1.4), (10, 6.0), (12, 8.9), (15, 15.0), (20, 33.9), (30, 28.9)],
)
def test_vertical_pattern_equals_the_table(elevation_deg: float, loss_db: float) -> None:
    power = vertical_two_way_power(np.sin(np.radians([elevation_deg])), math.radians(20.0))
    assert -10.0 * math.log10(power[0]) == pytest.approx(loss_db, abs=0.12)


def test_beam_is_as_wide_as_specified_and_doubles_at_60_degrees() -> None:
    pattern = azimuth_amplitude(math.radians(1.0), 30.0)

    def half_power(steer_deg: float, guess_deg: float) -> float:
        steered = math.sin(math.radians(steer_deg))
        return float(
            brentq(
                lambda off: (
                    float(pattern(np.array(math.sin(math.radians(steer_deg + off)) - steered)))
                    - math.sqrt(0.5)
                ),
                0.0,
                guess_deg,
            )
        )

    assert half_power(0.0, 1.0) == pytest.approx(0.5, abs=1e-4)
    assert half_power(60.0, 2.0) + half_power(-60.0, 2.0) == pytest.approx(2.0, abs=0.02)


def test_side_lobes_stay_below_the_design_level() -> None:
    pattern = azimuth_amplitude(math.radians(1.0), 30.0)
    beyond = np.abs(pattern(np.linspace(0.03, 1.0, 20000)))
    highest_db = 20.0 * math.log10(beyond.max())
    assert highest_db == pytest.approx(-30.0, abs=0.05)
    assert 20.0 * np.log10(beyond[-2000:].max()) < -55.0


@pytest.mark.parametrize("beams", [256, 512])
@pytest.mark.parametrize("place", np.random.default_rng(26).uniform(0.0, 1.0, 6))
def test_beams_hear_the_highest_side_lobe_wherever_they_lie_in_it(beams: int, place: float) -> None:
    sonar = SonarSettings(beams=beams)
    sines: NDArray[np.float64] = np.arange(beams, dtype=np.float64) + place - beams // 2
    sines *= sonar.sine_pitch
    heard = np.abs(azimuth_amplitude(sonar.beam_width_rad, 30.0)(sines))
    lobes = heard[np.abs(sines) > main_lobe_end(sonar.beam_width_rad, 30.0)]
    assert 20.0 * math.log10(lobes.max()) == pytest.approx(-30.0, abs=0.35)


@pytest.mark.parametrize("side_lobe_db", [13.27, 20.0, 25.0, 40.0, 55.0])
def test_any_side_lobes_can_be_had_at_the_same_width(side_lobe_db: float) -> None:
    width_rad = math.radians(1.0)
    pattern = azimuth_amplitude(width_rad, side_lobe_db)
    end = main_lobe_end(width_rad, side_lobe_db)
    lobes = np.abs(pattern(np.linspace(end, 0.2, 50001)))
    assert 20.0 * math.log10(lobes.max()) == pytest.approx(-side_lobe_db, abs=0.6)
    assert pattern(np.array([0.0, math.sin(width_rad / 2)])) == pytest.approx(
        [1.0, math.sqrt(0.5)], abs=1e-5
    )


@pytest.mark.parametrize("side_lobe_db", [60.0, math.inf])
def test_beam_without_side_lobes_is_gaussian(side_lobe_db: float) -> None:
    sines = np.linspace(-0.03, 0.03, 61)
    half = math.sin(math.radians(0.5))
    expected = 2.0 ** (-np.square(sines / half) / 2.0)
    assert azimuth_amplitude(math.radians(1.0), side_lobe_db)(sines) == pytest.approx(expected)


def test_point_target_scanned_across_the_fan_reproduces_the_pattern() -> None:
    pattern = azimuth_amplitude(SONAR.beam_width_rad, SONAR.side_lobe_db)
    target = 200
    field = np.zeros((5, SONAR.beams + 2 * MARGIN_BEAMS), dtype=np.complex64)
    field[2, MARGIN_BEAMS + target] = 1.0
    seen = formed(field)[2]
    expected = np.abs(
        pattern(np.arange(-target, SONAR.beams - target, dtype=np.float64) * SONAR.sine_pitch)
    )
    loud = expected > 10.0 ** (-30.0 / 20.0)
    found_db = 20.0 * np.log10(seen[loud] / seen[target])
    assert found_db == pytest.approx(20.0 * np.log10(expected[loud]), abs=0.1)


def test_beams_do_not_wrap_around_the_fan() -> None:
    field = np.zeros((64, SONAR.beams + 2 * MARGIN_BEAMS), dtype=np.complex64)
    field[0, MARGIN_BEAMS] = 1.0
    seen = formed(field)
    # So far off the side lobes are 60 dB down; a main lobe that came round would not be.
    assert seen[0, -20:].max() < 1e-3 * seen[0, 0]
    assert seen[-1].max() < 1e-3 * seen[0, 0]
