import dataclasses

import numpy as np
import pytest
from sonar_sim.receiver import gain_db, noise_level_db, pixels
from sonar_sim.sonar import SonarSettings
from sonar_sim.water import Water


def test_quantiser_takes_the_root_at_gamma_one_half() -> None:
    amplitude = np.array([1.0, 0.25, 0.0625, 1.0 / 65025.0], dtype=np.float32)
    half = (amplitude**0.5 * 255.0).tolist()
    assert half == pytest.approx([255.0, 127.5, 63.75, 1.0])
    # The byte 127 is the nearest there is to one half.
    found = pixels(amplitude, gamma_byte=127).astype(float)
    assert found == pytest.approx(half, abs=1.0)


@pytest.mark.parametrize("gamma_byte", [0, 255])
def test_quantiser_is_linear_rounds_and_saturates(gamma_byte: int) -> None:
    amplitude = np.array([-1.0, 0.0, 0.4 / 255, 0.6 / 255, 0.5, 1.0, 7.0], dtype=np.float32)
    assert pixels(amplitude, gamma_byte).tolist() == [0, 0, 0, 1, 128, 255, 255]


def test_varied_gain_makes_up_for_spreading_and_absorption() -> None:
    sonar = dataclasses.replace(SonarSettings(), demanded_range_m=10.0)
    gains = gain_db(sonar, absorption_db_per_m=0.2)
    near, far = (int(r / sonar.range_resolution_m) for r in (1.0, 8.0))
    assert gains[far] - gains[near] == pytest.approx(30 * np.log10(8) + 0.4 * 7, abs=0.3)


def test_floor_of_noise_lies_above_thermal_noise_by_its_excess() -> None:
    quiet = dataclasses.replace(SonarSettings(), noise_excess_db=0.0)
    step = noise_level_db(SonarSettings(), Water()) - noise_level_db(quiet, Water())
    assert step == pytest.approx(SonarSettings().noise_excess_db)
