from typing import Literal

import numpy as np
import pytest

from mapperd import CrosstalkFilter
from mapperd.config.tree import CrosstalkConfig
from mapperd.errors import ConfigError, MapError
from mapperd.imaging.crosstalk import without_stripes

Shape = Literal["rect", "ellipse", "cross"]


def block() -> np.ndarray:
    """200 rows of 128 beams with one thick echo that a stripe crosses."""
    image = np.zeros((200, 128), dtype=np.uint8)
    image[100:160, 20:60] = 120
    return image


def striped() -> np.ndarray:
    image = block()
    image[150:152] = 200
    return image


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_stripes_go_and_all_else_stays(dtype: type) -> None:
    scale = 257 if dtype is np.uint16 else 1
    image = striped().astype(dtype) * dtype(scale)
    cleared = CrosstalkFilter().apply(image)
    assert cleared.dtype == dtype
    assert (cleared == block().astype(dtype) * dtype(scale)).all()
    assert (CrosstalkFilter().apply(block()) == block()).all()


def test_it_is_the_filter_of_the_settings() -> None:
    image = np.random.default_rng(1).rayleigh(20.0, (200, 128)).clip(0, 255).astype(np.float32)
    image[80:83] += 60
    bearings = np.linspace(-1.0, 1.0, 128)
    cases: tuple[tuple[int, Shape, float], ...] = (
        (5, "rect", 0.5),
        (7, "ellipse", 0.3),
        (3, "cross", 0.9),
    )
    for kernel, shape, threshold in cases:
        settings = CrosstalkConfig(
            morpho_kernel_size=kernel, morpho_kernel_shape=shape, azimuth_threshold=threshold
        )
        crosstalk = CrosstalkFilter(
            kernel_size=kernel, kernel_shape=shape, consistency_threshold=threshold
        )
        ours = crosstalk.apply(image, bearings=bearings, intensity_threshold=50)
        assert (ours == without_stripes(image, bearings, settings, 50)).all()
    off = CrosstalkFilter(morpho_enabled=False, azimuth_check_enabled=False)
    assert (off.apply(image) == image).all()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("kernel_size", 1, ">= 2"),
        ("kernel_shape", "star", "rect or ellipse or cross"),
        ("consistency_threshold", 0, "> 0"),
        ("morpho_enabled", 1, "true or false"),
    ],
)
def test_wrong_values_are_named(name: str, value: object, words: str) -> None:
    with pytest.raises(
        ConfigError, match=rf"^{name}: {value!r} is not allowed; allowed: .*{words}"
    ):
        CrosstalkFilter(**{name: value})  # type: ignore[arg-type]


def test_what_is_no_image_of_a_fan_is_refused() -> None:
    for image, bearings in (
        (np.zeros(5, np.uint8), None),
        (block(), np.zeros(128)),
        (block(), np.linspace(-2.0, 2.0, 128)),
    ):
        with pytest.raises(MapError):
            CrosstalkFilter().apply(image, bearings=bearings)


def test_without_opencv_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match="OpenCV cannot be imported"):
        CrosstalkFilter()
