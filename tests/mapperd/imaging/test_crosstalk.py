"""Stripes go; floors seen flat, thin echoes and everything simulated stay."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from mapperd.config.tree import CrosstalkConfig
from mapperd.imaging.crosstalk import without_stripes
from tests.mapperd.imaging.conftest import BEAMS, Image, fan, flat_floor, speckled, striped

WIDE = fan(130)
THRESHOLD = 35.0
DEFAULT = CrosstalkConfig(enabled=True)

Simulated = Callable[[str, float], Image]


def cleared(
    image: Image, crosstalk: CrosstalkConfig = DEFAULT, bearings: NDArray[np.float64] | None = None
) -> Image:
    return without_stripes(image, WIDE if bearings is None else bearings, crosstalk, THRESHOLD)


def returns(image: Image) -> np.ndarray:
    return image > THRESHOLD


@pytest.mark.parametrize("field_of_view_deg", [30, 40, 70, 130])
@pytest.mark.parametrize("row", [5, 30, 60, 120, 300, 500])
def test_flat_floor_stays_as_it_is(field_of_view_deg: float, row: float) -> None:
    bearings = fan(field_of_view_deg)
    for level in (60, 160, 255):
        image = speckled(flat_floor(bearings, row, level))
        assert cleared(image, bearings=bearings) is image
    plain = flat_floor(bearings, row)
    assert cleared(plain, bearings=bearings) is plain


@pytest.mark.parametrize(("thickness", "level"), [(1, 60), (2, 25), (3, 120), (4, 250)])
def test_stripe_goes_and_the_floor_below_it_stays(thickness: int, level: float) -> None:
    floor = speckled(flat_floor(WIDE, 300))
    image = striped(floor, 420, thickness, level)
    false = returns(image) & ~returns(floor)
    assert false.sum() > 20
    out = cleared(image)
    assert (returns(out) & false).sum() <= 0.02 * false.sum()
    outside = np.r_[0:420, 420 + thickness : len(image)]
    assert (out[outside] == image[outside]).all()
    under = returns(floor)[420 : 420 + thickness]
    assert returns(out)[420 : 420 + thickness][under].mean() > 0.7


def test_stripe_across_the_nadir_of_a_floor_goes_and_the_floor_stays() -> None:
    mean = flat_floor(WIDE, 300)
    floor = speckled(mean)
    out = cleared(striped(floor, 302, 2, 120))
    near_floor = returns(mean) | returns(np.roll(mean, 2, 0)) | returns(np.roll(mean, -2, 0))
    assert (returns(out) & ~near_floor).sum() < 0.01 * 2 * BEAMS
    assert (returns(out) & ~returns(mean)).sum() < 0.05 * 2 * BEAMS
    assert returns(out)[returns(floor)].mean() > 0.99


@pytest.mark.parametrize("rows", [1, 2, 4])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.3, 0.6])
def test_thin_echo_that_does_not_span_the_fan_stays(rows: int, share: float) -> None:
    image = speckled(np.full((600, BEAMS), 4, dtype=np.float32))
    for first in (0, BEAMS // 3, BEAMS - round(share * BEAMS)):
        rope = image.copy()
        rope[300 : 300 + rows, first : first + round(share * BEAMS)] = 200
        assert cleared(rope) is rope


def test_facing_wall_seen_over_half_the_fan_stays() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[300:303, BEAMS // 4 : 3 * BEAMS // 4] = 200
    assert cleared(image) is image


def test_ring_thicker_than_the_kernel_is_no_stripe() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[300:305] = 200
    assert cleared(image) is image
    assert (cleared(image, CrosstalkConfig(morpho_kernel_size=6))[300:305] == 4).all()


def test_stripe_at_the_edges_of_the_image_goes() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[-2:] = 200
    assert (cleared(image)[-2:] <= 4).all()
    image[:2], image[-8:] = 200, 90
    assert (cleared(image, CrosstalkConfig(azimuth_enabled=False))[:2] <= 4).all()


def test_near_stripe_in_a_narrow_fan_is_left_as_a_wall_may_look_so() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[[50, 500]] = 200
    out = cleared(image, bearings=fan(40))
    assert (out[50] == 200).all()
    assert (out[500] == 4).all()


def test_share_of_the_sectors_decides() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    sectors = np.linspace(0, BEAMS, 25).round()
    sector = np.searchsorted(sectors, np.arange(BEAMS), side="right")
    image[300, sector % 2 == 0] = 200
    assert cleared(image, CrosstalkConfig(azimuth_threshold=0.6)) is image
    assert (cleared(image, CrosstalkConfig(azimuth_threshold=0.4))[300] == 4).all()


def test_without_azimuth_thin_echoes_go_as_well() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[300:302, :100] = 200
    image[400:420, :100] = 200
    out = cleared(image, CrosstalkConfig(azimuth_enabled=False))
    assert (out[300:302, :80] == 4).all()
    assert (out[400:420] == image[400:420]).all()


def test_without_morpho_thick_rings_go_as_well() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[300:330] = 200
    assert (cleared(image, CrosstalkConfig(morpho_enabled=False)) == 4).all()


def test_kernel_s_shape_decides_what_is_an_echo_of_its_own() -> None:
    image = np.full((600, BEAMS), 4, dtype=np.float32)
    image[300:305] = 200
    image[[300, 304], 22 * 5 : 22 * 6] = 4  # the ring's corners, of a sector
    shapes: list[Literal["rect", "ellipse", "cross"]] = ["rect", "ellipse", "cross"]
    kept = [
        (
            cleared(image, CrosstalkConfig(morpho_kernel_shape=shape, azimuth_enabled=False)) > 100
        ).sum()
        for shape in shapes
    ]
    assert kept[0] < kept[1] <= kept[2]


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["floor", "harbour"])
@pytest.mark.parametrize("pitch_deg", [0, 30, 60, 90])
def test_simulated_images_keep_every_sample(
    simulated: Simulated, scene: str, pitch_deg: float
) -> None:
    image = simulated(scene, pitch_deg)
    assert cleared(image) is image


@pytest.mark.parametrize("pitch_deg", [30, 60, 90])
@pytest.mark.parametrize(("row", "thickness", "level"), [(400, 3, 120), (550, 2, 60)])
def test_stripes_go_from_simulated_images(
    simulated: Simulated, pitch_deg: float, row: int, thickness: int, level: float
) -> None:
    image = simulated("harbour", pitch_deg)
    with_stripe = striped(image, row, thickness, level)
    # What touches an echo of the scene may be a part of it.
    touched = cv2.dilate(returns(image).astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    false = returns(with_stripe) & ~touched
    out = cleared(with_stripe)
    assert false.sum() > 500
    assert (returns(out) & false).sum() <= 0.02 * false.sum()
    assert returns(out)[returns(image)].mean() > 0.98


def test_image_is_not_written_to() -> None:
    image = striped(np.full((600, BEAMS), 4, dtype=np.float32), 300, 2, 200)
    image.setflags(write=False)
    assert cleared(image).dtype == np.float32


IMAGES = hnp.arrays(
    np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.integers(0, 255)
)


@given(IMAGES, st.booleans(), st.booleans(), st.integers(2, 101))
@settings(max_examples=60)
def test_any_image_comes_out_nowhere_brighter(
    image: Image,
    morpho: bool,  # noqa: FBT001
    azimuth: bool,  # noqa: FBT001
    kernel: int,
) -> None:
    crosstalk = CrosstalkConfig(
        morpho_enabled=morpho, azimuth_enabled=azimuth, morpho_kernel_size=kernel
    )
    bearings = np.linspace(-1, 1, image.shape[1])
    out = without_stripes(image, bearings, crosstalk, THRESHOLD)
    assert out.shape == image.shape
    assert (out <= image).all()
    assert (out >= 0).all()
