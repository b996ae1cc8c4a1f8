from collections.abc import Callable

import numpy as np
import pytest

from mapperd.config.tree import SonarConfig
from mapperd.errors import MapError
from mapperd.imaging.ping_image import ping_image_of
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]


@pytest.mark.parametrize(
    ("dtype", "width", "full"),
    [(np.uint8, 1, 2**8 - 1), (np.uint16, 2, 2**16 - 1), (np.uint32, 4, 2**32 - 1)],
)
def test_samples_are_scaled_to_255_without_truncation(
    ping: MakePing, dtype: type[np.unsignedinteger], width: int, full: int
) -> None:
    step = full // 255
    image = np.zeros((50, 65), dtype=dtype)
    image[0, :4] = [full, 35 * step, 36 * step, 35 * step + (1 if width > 1 else 0)]
    echo = ping_image_of(ping(image=image), SonarConfig())
    assert echo.intensity.dtype == np.float32
    assert echo.intensity[0, 0] == 255
    assert echo.intensity[0, 1] == 35  # exactly: the threshold is strict
    assert echo.intensity[0, 2] == 36
    if width == 2:
        assert echo.intensity[0, 3] > 35


def test_24_bit_samples_are_scaled(ping: MakePing) -> None:
    image = np.full((50, 65), 2**24 - 1, dtype=np.uint32)
    assert (ping_image_of(ping(image=image, data_size=3), SonarConfig()).intensity == 255).all()


def test_gain_words_are_left_out_and_not_applied(ping: MakePing) -> None:
    gains = np.full(50, 900, dtype=np.uint32)
    image = np.full((50, 65), 77, dtype=np.uint8)
    assert (ping_image_of(ping(image=image, gains=gains), SonarConfig()).intensity == 77).all()


def test_beams_outside_the_field_of_view_are_left_out(ping: MakePing) -> None:
    whole, half = ping(), ping_image_of(ping(), SonarConfig(horizontal_fov=60.0))
    inside = np.abs(np.rad2deg(whole.bearings_rad)) <= 30.001
    assert half.bearings_rad == pytest.approx(whole.bearings_rad[inside])
    assert half.intensity.shape == (50, inside.sum())
    assert half.intensity.flags.c_contiguous


def test_default_field_of_view_keeps_beams_on_its_edge(ping: MakePing) -> None:
    table = np.linspace(-6500, 6500, 65).round().astype(np.int16)
    assert ping_image_of(ping(bearings_cdeg=table), SonarConfig()).bearings_rad.size == 65


def test_echo_is_read_only(ping: MakePing) -> None:
    echo = ping_image_of(ping(), SonarConfig())
    with pytest.raises(ValueError, match="read-only"):
        echo.intensity[0, 0] = 1
    assert echo.max_range_m == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        (np.zeros(65, dtype=np.int16), "bad_bearings"),
        (np.linspace(6000, -6000, 65).round().astype(np.int16), "bad_bearings"),
        (np.arange(7000, 7065, dtype=np.int16), "outside_fov"),
    ],
)
def test_bearings_that_are_no_fan_are_refused(
    ping: MakePing, table: np.ndarray, reason: str
) -> None:
    with pytest.raises(MapError) as caught:
        ping_image_of(ping(bearings_cdeg=table), SonarConfig())
    assert caught.value.reason == reason
