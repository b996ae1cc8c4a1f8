import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.localization.detector import equalised, levels_db

RNG = np.random.default_rng(3)


def noise(rows: int = 400, beams: int = 128) -> NDArray[np.float32]:
    return RNG.rayleigh(20.0, (rows, beams)).astype(np.float32)


def test_levels_are_decibels_of_amplitude_and_silence_is_finite() -> None:
    image = np.array([[1, 10, 100, 0]], dtype=np.float32)
    assert levels_db(image)[0] == pytest.approx([0, 20, 40, -6.0206], abs=1e-4)


@pytest.mark.parametrize("gamma", [0, 255])
def test_no_exponent_leaves_levels(gamma: int) -> None:
    assert levels_db(np.full((1, 1), 10, np.float32), gamma)[0, 0] == pytest.approx(20)


def test_exponent_of_the_image_is_taken_back() -> None:
    amplitude = np.array([[0.5, 0.05]])
    shown = (255 * amplitude ** (127 / 255)).astype(np.float32)
    levels = levels_db(shown, 127)
    assert levels[0, 0] - levels[0, 1] == pytest.approx(20, abs=1e-3)


def test_gain_over_range_and_over_beams_is_undone() -> None:
    image = noise()
    over_range = np.linspace(1, 10, 400, dtype=np.float32)[:, None]
    over_beams = np.linspace(0.7, 1.4, 128, dtype=np.float32)
    plain = levels_db(image)
    level = equalised(levels_db(image * over_range * over_beams), 0.02)
    # A gain of 20 dB; within half a block of the nearest row it is not followed.
    assert np.abs(np.median(level, axis=1)).max() < 3.0
    # What two beams of one noise differ by is theirs, not the gain's.
    assert np.corrcoef(np.arange(128), np.median(level, axis=0))[0, 1] ** 2 < 0.3
    assert np.std(level) < np.std(plain) + 0.5


def test_a_wall_at_one_range_in_all_beams_stays() -> None:
    image = noise()
    image[200:203] = 200.0
    level = equalised(levels_db(image), 0.02)
    assert np.median(level[201]) > 15
    assert abs(np.median(level[190])) < 2


def test_a_surface_all_along_a_beam_is_not_taken_for_its_gain() -> None:
    levels = np.zeros((400, 128), np.float32)
    levels[:, 7], levels[:, 9] = 20.0, 4.0
    level = equalised(levels, 0.02)
    assert (level[:, 7] == 14.0).all()
    assert (level[:, 9] == 0.0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (9, 3)])
def test_small_images_are_images(shape: tuple[int, int]) -> None:
    level = equalised(levels_db(np.ones(shape, dtype=np.float32)), 0.02)
    assert level.shape == shape
    assert np.isfinite(level).all()
