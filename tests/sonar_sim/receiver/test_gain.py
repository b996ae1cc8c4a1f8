import dataclasses

import numpy as np
import pytest
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.gain import amplitude, gain_db, noise_level_db, quantise, row_gain
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water

PIXELS = Physics(quantised=True, saturation=True, gamma=True)


def test_quantiser_takes_the_root_at_gamma_one_half() -> None:
    amplitude = np.array([1.0, 0.25, 0.0625, 1.0 / 65025.0], dtype=np.float32)
    half = (amplitude**0.5 * 255.0).tolist()
    assert half == pytest.approx([255.0, 127.5, 63.75, 1.0])
    # The byte 127 is the nearest there is to one half.
    found = quantise(amplitude, PIXELS, 127).astype(float)
    assert found == pytest.approx(half, abs=1.0)


@pytest.mark.parametrize("gamma_byte", [0, 255])
def test_quantiser_is_linear_rounds_and_saturates(gamma_byte: int) -> None:
    amplitude = np.array([0.0, 0.4 / 255, 0.6 / 255, 0.5, 1.0, 7.0], dtype=np.float32)
    assert quantise(amplitude, PIXELS, gamma_byte).tolist() == [0, 0, 1, 128, 255, 255]


def test_varied_gain_makes_up_for_spreading_and_absorption() -> None:
    sonar = dataclasses.replace(SonarSettings(), demanded_range_m=10.0)
    gains = gain_db(sonar, absorption_db_per_m=0.2)
    near, far = (int(r / sonar.range_resolution_m) for r in (1.0, 8.0))
    assert gains[far] - gains[near] == pytest.approx(30 * np.log10(8) + 0.4 * 7, abs=0.3)


def test_gains_of_a_row_are_those_called_for() -> None:
    sonar = SonarSettings()
    none, varied, both = (
        20.0 * np.log10(row_gain(sonar, physics, 0.2))
        for physics in (Physics(), Physics(tvg=True), Physics(tvg=True, gain=True))
    )
    assert np.ptp(none) < 1e-4
    assert both - none == pytest.approx(gain_db(sonar, 0.2), abs=1e-3)
    assert both - varied == pytest.approx(0.96 * 50.0, abs=1e-3)


def test_amplitude_of_a_field_and_of_its_power_are_one() -> None:
    field = np.array([[3.0 + 4.0j, -2.0j]], dtype=np.complex64)
    gain = np.array([0.1], dtype=np.float32)
    power = np.square(np.abs(field)).astype(np.float32)
    assert amplitude(field, gain)[0] == pytest.approx([0.5, 0.2])
    assert amplitude(power, gain) == pytest.approx(amplitude(field, gain))


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16), (32, np.uint32)])
def test_quantiser_has_the_width_asked_for(bits: int, dtype: type) -> None:
    shown = np.array([[0.0, 0.25, 1.0, 9.0]], dtype=np.float32)
    physics = Physics(quantised=True, saturation=True, gamma=True)
    image = quantise(shown, physics, 255, bits)
    end = 2**bits - 1
    assert image.dtype == dtype
    assert image.tolist() == [[0, pytest.approx(0.25 * end, abs=0.5), end, end]]


def test_each_stage_of_the_pixel_law_can_be_left_out() -> None:
    shown = np.array([0.25, 4.0], dtype=np.float32)
    assert quantise(shown, Physics()).tolist() == [0.25, 4.0]
    assert quantise(shown, Physics(saturation=True)).tolist() == [0.25, 1.0]
    rooted = quantise(shown, Physics(gamma=True), 127)
    assert rooted == pytest.approx(shown ** (127 / 255), rel=1e-5)
    assert quantise(shown, Physics(quantised=True), 127).tolist() == [64, 255]


def test_pixels_are_the_rounded_power_of_what_is_clipped() -> None:
    shown = np.linspace(0.0, 1.2, 5001, dtype=np.float32)
    for gamma_byte, gamma in ((0, 1.0), (127, 127 / 255), (255, 1.0)):
        exact = 255.0 * np.minimum(shown.astype(float), 1.0) ** gamma
        assert np.abs(quantise(shown, PIXELS, gamma_byte) - exact).max() < 0.501


def test_floor_of_noise_lies_above_thermal_noise_by_its_excess() -> None:
    quiet = dataclasses.replace(SonarSettings(), noise_excess_db=0.0)
    step = noise_level_db(SonarSettings(), Water()) - noise_level_db(quiet, Water())
    assert step == pytest.approx(SonarSettings().noise_excess_db)
