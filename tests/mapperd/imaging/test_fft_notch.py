import numpy as np
import pytest

from mapperd.config.tree import CrosstalkConfig
from mapperd.imaging.crosstalk import notched
from tests.mapperd.imaging.conftest import BEAMS, Image, fan, flat_floor, speckled, striped


def by_the_book(image: Image, width: float, strength: float, dc: float) -> Image:
    """The published steps, in float64 on the whole centred spectrum."""
    rows, beams = image.shape
    fy = (np.arange(rows) - rows // 2)[:, None]
    fx = (np.arange(beams) - beams // 2)[None, :]
    g = np.exp(-((np.abs(fx) / (beams / 2)) ** 2) / (2 * width**2))
    q = max(2, dc * rows / 2)
    mask = np.clip(1 - strength * g * (1 - np.exp(-(fy**2) / (2 * q**2))), 0, 1)
    spectrum = np.fft.fftshift(np.fft.fft2(image.astype(np.float64))) * mask
    out = np.fft.ifft2(np.fft.ifftshift(spectrum)).real
    return np.clip(out, 0, 255).astype(np.float32)


@pytest.mark.parametrize("shape", [(600, 512), (61, 33), (4, 4), (60, 7)])
@pytest.mark.parametrize(("width", "strength", "dc"), [(0.02, 0.8, 0.05), (0.5, 1, 0), (1, 0, 0.5)])
def test_notch_is_the_published_one(
    shape: tuple[int, int], width: float, strength: float, dc: float
) -> None:
    image = speckled(np.full(shape, 60, dtype=np.float32))
    ours = notched(
        image,
        CrosstalkConfig(filter_width=width, filter_strength=strength, dc_preserve_ratio=dc),
    )
    assert np.abs(ours - by_the_book(image, width, strength, dc)).max() < 0.01
    assert ours.dtype == np.float32


def test_strength_zero_changes_nothing() -> None:
    image = speckled(np.full((60, 64), 60, dtype=np.float32))
    assert np.abs(notched(image, CrosstalkConfig(filter_strength=0)) - image).max() < 1e-3


def test_tiny_images_stay() -> None:
    image = np.full((3, 512), 9, dtype=np.float32)
    assert notched(image, CrosstalkConfig()) is image


def test_stripe_is_weakened_and_so_is_a_floor_seen_flat() -> None:
    """Its known limit, which is why it is off by default: echoes along the stripes go too."""
    bearings = fan(130)
    floor = flat_floor(bearings, 300)
    out = notched(striped(floor, 420, 3, 160), CrosstalkConfig())
    assert out[421, :100].mean() < 0.6 * 160
    assert floor[301, BEAMS // 2] == 160
    assert out[301, BEAMS // 2] < 150
