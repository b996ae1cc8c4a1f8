"""The noise of an image, and what stands out of it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oculus_driver.noise import is_echo, noise_by_range

ROWS, BEAMS = 400, 256
QUARTILE = np.sqrt(2 * np.log(4 / 3))
"""Of Rayleigh noise, over its scale."""


def rising_noise() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rayleigh noise whose scale rises with range as a gain over time makes it; and the scale."""
    scale = 1.0 + 9.0 * np.linspace(0.0, 1.0, ROWS) ** 2
    return np.random.default_rng(5).rayleigh(scale[:, None], (ROWS, BEAMS)), scale


def test_noise_follows_the_gain_over_time() -> None:
    image, scale = rising_noise()
    inside = slice(ROWS // 16, -ROWS // 16)
    found = noise_by_range(image)[inside] / (QUARTILE * scale[inside])
    assert found == pytest.approx(1.0, abs=0.12)
    assert noise_by_range(20 * image) == pytest.approx(20 * noise_by_range(image), rel=1e-5)


def test_surfaces_do_not_count_as_noise() -> None:
    image, _ = rising_noise()
    alone = noise_by_range(image)
    image[100:180] += 100.0  # a wall over all of the fan
    image[:, :100] += 100.0  # and one over part of it
    assert (noise_by_range(image) < 1.6 * np.maximum(alone, alone[200])).all()
    walls = np.zeros(image.shape, dtype=bool)
    walls[100:180] = walls[:, :100] = True
    found = is_echo(image, 5.0)
    assert found[walls].mean() > 0.95
    assert found[~walls].mean() < 0.01


def test_false_echoes_are_as_rare_as_rayleigh_noise_makes_them() -> None:
    image = np.random.default_rng(6).rayleigh(10.0, (4000, 1000))
    for factor in (3.0, 4.0, 5.0):
        expected = image.size * np.exp(-((factor * QUARTILE) ** 2) / 2)
        assert is_echo(image, factor).sum() == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (17, 5), (1000, 1)])
def test_small_images_have_a_noise_too(shape: tuple[int, int]) -> None:
    assert noise_by_range(np.full(shape, 7, dtype=np.uint8)).tolist() == [7.0] * shape[0]


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (5,), (2, 2, 2)])
def test_what_is_no_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        noise_by_range(np.zeros(shape))
