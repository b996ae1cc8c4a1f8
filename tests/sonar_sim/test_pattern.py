import math

import numpy as np
import pytest
from scipy.optimize import brentq
from sonar_sim.casting import MARGIN_BEAMS
from sonar_sim.pattern import azimuth_amplitude, vertical_two_way_power
from sonar_sim.sonar import SonarSettings
from sonar_sim.speckle import beam_former


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
    assert highest_db == pytest.approx(-30.0, abs=0.7)
    assert 20.0 * np.log10(beyond[-2000:].max()) < -50.0


def test_pattern_is_smooth_where_its_zeros_cancel() -> None:
    pattern = azimuth_amplitude(math.radians(1.0), 30.0)
    values = pattern(np.linspace(-0.2, 0.2, 100001))
    assert np.all(np.isfinite(values))
    assert np.abs(np.diff(values)).max() < 1e-3


def test_point_target_scanned_across_the_fan_reproduces_the_pattern() -> None:
    sonar = SonarSettings()
    pattern = azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)
    target = 200
    field = np.zeros((5, sonar.beams + 2 * MARGIN_BEAMS), dtype=np.complex64)
    field[2, MARGIN_BEAMS + target] = 1.0
    seen = np.abs(beam_former(sonar)(field)[2])
    expected = np.abs(
        pattern(np.arange(-target, sonar.beams - target, dtype=np.float64) * sonar.sine_pitch)
    )
    loud = expected > 10.0 ** (-30.0 / 20.0)
    found_db = 20.0 * np.log10(seen[loud] / seen[target])
    assert found_db == pytest.approx(20.0 * np.log10(expected[loud]), abs=0.1)


def test_beams_do_not_wrap_around_the_fan() -> None:
    sonar = SonarSettings()
    field = np.zeros((5, sonar.beams + 2 * MARGIN_BEAMS), dtype=np.complex64)
    field[0, MARGIN_BEAMS] = 1.0
    seen = np.abs(beam_former(sonar)(field))
    assert seen[0, -20:].max() < 1e-4 * seen[0, 0]
    assert np.all(seen[2:] < 1e-6)
