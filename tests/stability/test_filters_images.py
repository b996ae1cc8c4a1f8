"""Hard cases of the filters on a ping's image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from mapperd.config.tree import (
    Config,
    CrosstalkConfig,
    RobotDetectionConfig,
    TerrainDetectionConfig,
)
from mapperd.imaging.crosstalk import notched, without_stripes
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import PingImage, ping_image_of_array, uniform_bearings
from mapperd.imaging.robots import MAX_SIGHTINGS, Sighting, Sightings, find_robots, terrain_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

USUAL = CrosstalkConfig(enabled=True)
STRONGEST = replace(USUAL, filter_strength=1.0, filter_width=1.0, dc_preserve_ratio=0.0)
SHAPES = [(1, 1), (1, 64), (64, 1), (2, 2), (3, 512), (512, 3), (5, 7)]


def fan(beams: int, half_rad: float = 1.1) -> NDArray[np.float64]:
    return np.linspace(-half_rad, half_rad, beams) if beams > 1 else np.zeros(1)


def noise(shape: tuple[int, int] = (128, 96)) -> NDArray[np.float32]:
    return np.random.default_rng(12).uniform(20, 30, shape).astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_image_smaller_than_the_kernel_goes_through(shape: tuple[int, int]) -> None:
    """Images of one row or a few beams come from cut recordings and narrow fields of view.

    Naively the kernel is taken for smaller than the image, and there are 24 sectors of a single
    beam: means of nothing are not numbers.
    """
    image = np.full(shape, 100, np.float32)
    tall = replace(USUAL, morpho_kernel_size=101)
    for settings in (USUAL, tall, replace(tall, morpho_enabled=False)):
        got = without_stripes(image, fan(shape[1]), settings, 35.0)
        assert got.shape == shape
        assert np.isfinite(got).all()
        assert (got <= image).all()
    assert np.isfinite(notched(image, STRONGEST)).all()


def test_a_constant_image_keeps_its_level() -> None:
    """A sonar in mud sends the same everywhere: there is no stripe, and nothing to divide by.

    Naively the contrast is a ratio to a spread of 0; and the notch, in which all of the image is
    at frequency 0, takes it away.
    """
    for level in (0.0, 1e-38, 35.0, 255.0):
        image = np.full((128, 96), level, np.float32)
        assert (without_stripes(image, fan(96), USUAL, 35.0) == image).all()
        assert notched(image, STRONGEST) == pytest.approx(image, abs=1e-4)


def test_an_image_of_silence_stays_silence() -> None:
    """Open water is all zeros, and stays so through every filter that may be on.

    Naively the inverse transform leaves its roundings, some 1e-6 and of both signs: below 0 there
    is no intensity, and above a threshold of 0 all of it is an echo.
    """
    silence = np.zeros((128, 96), np.float32)
    assert without_stripes(silence, fan(96), USUAL, 0.0) is silence
    assert (notched(silence, STRONGEST) == 0).all()
    assert find_robots(silence, fan(96), 0.1, RobotDetectionConfig(min_threshold=180.0)) == []


def test_stripes_at_full_scale_side_by_side_leave_what_is_between() -> None:
    """Another sonar close by saturates every tenth row over the whole fan.

    Naively a stripe is replaced by the mean of its neighbours, which are stripes as well, or of
    what is beyond the image: rows at the edges take what they find in memory.
    """
    image = noise()
    clean = image.copy()
    image[::10] = 255.0
    got = without_stripes(image, fan(96), USUAL, 35.0)
    far = np.arange(128) >= 60
    assert got[far].max() <= 30.0
    between = far & (np.arange(128) % 10 != 0)
    assert (got[between] == clean[between]).all()
    assert (got >= 0).all()


def test_an_image_of_alternating_rows_is_not_made_brighter() -> None:
    """Interference may be as fast as rows can change, from full scale to nothing and back.

    Naively the notch rings: what is beside a bright row is lifted above it, or below 0.
    """
    alternating, edge, gap = np.zeros((3, 128, 96), np.float32)
    alternating[::2] = edge[:6] = 255.0
    gap[:] = 255.0
    gap[60:66] = 0.0
    for image in (alternating, edge, gap):
        for settings in (USUAL, STRONGEST, replace(USUAL, filter_width=0.001)):
            for got in (notched(image, settings), without_stripes(image, fan(96), settings, 35.0)):
                assert np.isfinite(got).all()
                assert got.min() >= 0.0
                assert got.max() <= 255.0


def test_single_precision_of_the_notch_is_that_of_double() -> None:
    """Images are single precision, and their transform sums half a million samples.

    Naively the sums are single precision as well, and what is weak beside a bright row is its
    rounding.
    """
    image = (noise((512, 512)) / 30).astype(np.float32)
    image[300] = 255.0
    got = notched(image, USUAL).astype(np.float64)
    spectrum = np.fft.rfft2(image.astype(np.float64))
    over_beams = np.fft.rfftfreq(512)[None, :] * 2
    over_rows = np.fft.fftfreq(512)[:, None] * 512
    stripe = np.exp(-((over_beams / 0.02) ** 2) / 2)
    changing = 1 - np.exp(-((over_rows / max(2.0, 0.05 * 256)) ** 2) / 2)
    exact = np.clip(np.fft.irfft2(spectrum * (1 - 0.8 * stripe * changing), s=(512, 512)), 0, 255)
    assert np.abs(got - exact).max() < 2e-5


def test_a_fan_of_no_width_shows_no_stripe() -> None:
    """Where all beams look one way a wall is as flat as a stripe; nothing separates them.

    Naively the bend of a plane over the fan is 1 / cos(0) - 1, by which a row is divided.
    """
    image = noise()
    image[100] = 255.0
    for half_rad in (0.0, 1e-12, 1e-6):
        bearings = np.linspace(-half_rad, half_rad, 96)
        assert without_stripes(image, bearings, USUAL, 35.0) is image
    wide = without_stripes(image, fan(96, np.pi / 2), replace(USUAL, azimuth_threshold=1.0), 35.0)
    assert np.isfinite(wide).all()


def test_a_robot_of_the_whole_image_has_its_middle_in_the_middle() -> None:
    """A diver right before the sonar fills the image: one group of half a million samples.

    Naively range times intensity is summed in single precision, which ends its whole numbers at
    16 million: the centre is metres off.
    """
    image = np.full((720, 512), 255, np.float32)
    (robot,) = find_robots(image, fan(512), 0.1, RobotDetectionConfig(min_threshold=180.0))
    assert robot.samples == 720 * 512
    assert robot.range_m == pytest.approx(36.0, abs=1e-9)
    assert robot.bearing_rad == pytest.approx(0.0, abs=1e-9)
    naive = np.cumsum((image * (np.arange(720)[:, None] + 0.5)).ravel(), dtype=np.float32)[-1]
    assert abs(naive / np.cumsum(image.ravel(), dtype=np.float32)[-1] * 0.1 - 36.0) > 0.01


def test_silence_is_no_robot_at_any_threshold() -> None:
    """With a threshold of 0 the samples without an echo are as bright as robots have to be.

    Naively they are a robot, whose centre is the mean of their places weighted by nothing: 0 / 0.
    """
    settings = RobotDetectionConfig(min_threshold=0.0)
    assert find_robots(np.zeros((20, 30), np.float32), fan(30), 0.1, settings) == []
    (robot,) = find_robots(np.full((20, 30), 1e-45, np.float32), fan(30), 0.1, settings)
    assert robot.range_m == pytest.approx(1.0)
    assert robot.bearing_rad == pytest.approx(0.0, abs=1e-12)


def test_bands_that_touch_leave_no_sample_out_and_none_in_both() -> None:
    """Terrain ends where robots begin, at one number that is not a whole one.

    Naively the two bands compare in different precision, and a sample at the limit is neither.
    """
    limit = 179.9
    terrain = TerrainDetectionConfig(min_threshold=0.0, max_threshold=limit)
    robots = RobotDetectionConfig(min_threshold=limit, min_samples=1, keep_out=True)
    around = np.float32(limit)
    image = np.stack([np.nextafter(around, np.float32(0)), around, np.nextafter(around, 255)])
    image = np.repeat(image.astype(np.float32)[:, None], 9, axis=1)
    image[:, 1::2] = 0
    is_robot = image.astype(np.float64) >= np.float64(np.float32(limit))
    seen = terrain_of(image, terrain, robots)
    assert ((seen == image) | (is_robot & (seen == 0))).all()
    assert ((seen > 0) ^ is_robot)[:, ::2].all()


def test_all_filters_together_take_any_fan_to_finite_samples() -> None:
    """What one filter leaves, the next one takes: in any order nothing infinite may come out.

    Naively each is tested alone, and the threshold after the notch sees numbers below 0.
    """
    config = Config(
        crosstalk=replace(STRONGEST, fft_enabled=True),
        robot_detection=RobotDetectionConfig(enabled=True, min_samples=1),
    )
    rng = np.random.default_rng(2)
    for shape in ((1, 2), (4, 4), (64, 48), (200, 3)):
        for level in (0.0, 1e-38, 255.0):
            image = np.where(rng.uniform(size=shape) < 0.5, level, 0).astype(np.float32)
            echo, robots = filter_ping_image(PingImage(image, fan(shape[1]), 0.05), config)
            assert np.isfinite(echo.intensity).all()
            assert ((echo.intensity >= 0) & (echo.intensity <= 255)).all()
            assert all(np.isfinite([r.range_m, r.bearing_rad, r.peak]).all() for r in robots)


def test_sightings_at_the_ends_of_time_expire() -> None:
    """Sightings are kept by arrival in nanoseconds, and a clock may be set by decades.

    Naively the age is worked out as a double of seconds: beside 1.7e9 s its last bit is 0.2 µs, and
    beside 2**63 ns 2 µs.
    """
    sightings = Sightings()
    for t_ns in (0, 2**62, 2**63 - 1):
        sightings.add([Sighting(t_ns, (0.0, 0.0, 0.0), None)])  # type: ignore[arg-type]
        assert [one.t_ns for one in sightings.since(t_ns, 1e-9)] == [t_ns]
        assert sightings.since(t_ns + 2, 1e-9) == []
    sightings.add(
        Sighting(k, (0.0, 0.0, 0.0), None)  # type: ignore[arg-type]
        for k in range(MAX_SIGHTINGS + 10)
    )
    assert sightings.crowded_out == 10


def test_bearings_of_a_fan_of_180_degrees_stay_below_it() -> None:
    """Uniform in sine, the outermost beams of a fan of 180° are where the sine is exactly 1.

    Naively the sine of a rounded right angle is a last bit beyond 1, and its arc no number.
    """
    sonar = replace(Config().sonar, horizontal_fov=180.0)
    for beams in (2, 3, 512):
        table = uniform_bearings(beams, sonar)
        assert np.isfinite(table).all()
        assert (np.diff(table) > 0).all()
        assert abs(table).max() <= np.pi / 2
        echo = ping_image_of_array(np.zeros((4, beams), np.uint8), 10.0, None, sonar)
        assert len(echo.bearings_rad) == beams
