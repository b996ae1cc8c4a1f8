import math
from collections.abc import Callable

import numpy as np
import pytest

from mapperd.config.tree import SonarConfig
from mapperd.imaging.ping_image import PingImage, ping_image_of_array

MakeEcho = Callable[..., PingImage]


@pytest.fixture
def make_echo() -> MakeEcho:
    """Rayleigh noise, and echoes at (range_m, intensity, first beam, last beam)."""

    def make(
        *echoes: tuple[float, float, int, int],
        rows: int = 500,
        beams: int = 128,
        range_m: float = 10.0,
        noise: float = 2.0,
        seed: int = 1,
        fov_deg: float = 120.0,
    ) -> PingImage:
        image = np.random.default_rng(seed).rayleigh(noise, (rows, beams))
        for at_m, intensity, first, last in echoes:
            row = int(at_m / range_m * rows)
            image[row, first : last + 1] += intensity
            image[row + 1 : row + 4, first : last + 1] += intensity / 2
        shown = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        half = math.radians(fov_deg / 2)
        bearings = np.arcsin(np.linspace(-math.sin(half), math.sin(half), beams))
        return ping_image_of_array(shown, range_m, bearings, SonarConfig(horizontal_fov=180))

    return make
