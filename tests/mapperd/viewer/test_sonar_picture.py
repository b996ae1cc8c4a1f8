"""The sonar image of the page: a fan in true geometry, with detections and the threshold."""

import numpy as np
import pytest
import zstandard
from numpy.typing import NDArray

pytest.importorskip("PIL", reason="the extra `topside` is not installed")

from mapperd.viewer.sonar_panel import DETECTION, WATER, SonarPicture
from mapperd.wire.messages import ImageMessage, ReturnsMessage
from oculus_driver.fan import FanGeometry

ROWS, BEAMS, STEP_M = 100, 65, 0.1
BEARINGS = np.radians(np.linspace(-65.0, 65.0, BEAMS))


def image_of(samples: NDArray[np.uint8]) -> ImageMessage:
    return ImageMessage(
        stamp_ns=0,
        ping_id=1,
        rows=ROWS,
        beams=BEAMS,
        range_resolution_m=STEP_M,
        bearings_rad=BEARINGS.astype("<f4").tobytes(),
        body=zstandard.compress(samples.tobytes()),
    )


def drawn(
    samples: NDArray[np.uint8], threshold: float = 35.0, returns: ReturnsMessage | None = None
) -> tuple[NDArray[np.uint8], FanGeometry]:
    picture = SonarPicture()
    pixels = picture.draw(image_of(samples), returns, threshold)
    assert picture._fan is not None
    return pixels, picture._fan


def at(pixels: NDArray[np.uint8], fan: FanGeometry, range_m: float, bearing: float) -> list[int]:
    x, y = fan.pixel(range_m, bearing)
    return [int(one) for one in pixels[int(y), int(x)]]


@pytest.mark.parametrize("bearing_deg", [-50.0, -20.0, 10.0, 50.0])
def test_an_echo_stands_where_it_was_heard(bearing_deg: float) -> None:
    bearing = float(np.radians(bearing_deg))
    beam = int(np.abs(BEARINGS - bearing).argmin())
    samples = np.zeros((ROWS, BEAMS), np.uint8)
    samples[68:73, beam - 1 : beam + 2] = 250  # 7 m; rings are at even metres
    pixels, fan = drawn(samples)
    assert max(at(pixels, fan, 7.05, bearing)) > 200
    assert max(at(pixels, fan, 7.05, -bearing)) < 40, "starboard is not port"
    assert max(at(pixels, fan, 5.05, bearing)) < 40


def test_rings_are_at_whole_metres_and_outside_is_empty() -> None:
    pixels, fan = drawn(np.zeros((ROWS, BEAMS), np.uint8))
    for range_m in (2.0, 4.0, 6.0, 8.0):
        x, y = fan.pixel(range_m, 0.3)
        around = pixels[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2]
        assert around.max() > 100, range_m
    assert at(pixels, fan, 5.0, 1.35) == list(WATER)


def test_samples_at_or_below_the_threshold_are_grey() -> None:
    samples = np.full((ROWS, BEAMS), 100, np.uint8)
    for threshold, is_grey in ((99.0, False), (100.0, True), (180.0, True)):
        red, green, blue = at(*drawn(samples, threshold), 5.05, 0.1)
        assert (red == green == blue) is is_grey, threshold


def test_detections_are_drawn_over_the_image() -> None:
    points = np.array([[5.0, 2.0, 0.0]], "<f4")  # 5 m ahead, 2 m to port
    returns = ReturnsMessage(
        stamp_ns=0, ping_id=1, points=points.tobytes(), intensities=b"\xff", outcome="mapped"
    )
    pixels, fan = drawn(np.zeros((ROWS, BEAMS), np.uint8), returns=returns)
    range_m, bearing = float(np.hypot(5, 2)), float(-np.arctan2(2, 5))
    assert at(pixels, fan, range_m, bearing) == list(DETECTION)


def test_the_geometry_follows_the_range() -> None:
    picture = SonarPicture()
    near = image_of(np.zeros((ROWS, BEAMS), np.uint8))
    picture.draw(near, None, 0.0)
    far = ImageMessage(
        stamp_ns=0,
        ping_id=2,
        rows=ROWS,
        beams=BEAMS,
        range_resolution_m=2 * STEP_M,
        bearings_rad=near.bearings_rad,
        body=near.body,
    )
    before = picture._fan
    picture.draw(far, None, 0.0)
    assert before is not None
    assert picture._fan is not None
    assert picture._fan.metres_per_px == pytest.approx(2 * before.metres_per_px)
