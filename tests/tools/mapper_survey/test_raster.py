"""Pixels lie where their columns of voxels do."""

import numpy as np
import pytest
from mapper_survey.coverage import MAX_PIXELS, Raster
from mapper_survey.windows import Tiling


def test_corners_of_the_map_are_those_of_the_picture() -> None:
    raster = Raster(Tiling(-128, 256, 128, 2, 3, {}), 0.1)
    picture = raster.full(0.0)
    raster.put(picture, np.add.at, np.array([-128, 127, 127]), np.array([255, -128, -128]), 1.0)
    assert (picture.shape, picture[0, 0], picture[-1, -1]) == ((384, 256), 1.0, 2.0)
    assert picture.sum() == 3.0
    assert raster.extent_m == pytest.approx((-12.8, 12.8, -12.8, 25.6))
    seen = raster.full(0.0) > 0
    seen[10:110, 20:70] = True
    left, right, bottom, top = raster.shown_m(seen)
    assert (left, right) == pytest.approx((-10.8 - 0.3, -5.8 + 0.3))
    assert (bottom, top) == pytest.approx((14.6 - 0.3, 24.6 + 0.3))


def test_wide_map_has_several_columns_to_a_pixel() -> None:
    raster = Raster(Tiling(0, 128, 128, 100, 1, {}), 0.1)
    assert max(raster.shape) <= MAX_PIXELS
    picture = raster.full(-np.inf)
    raster.put(picture, np.maximum.at, np.array([0, 10]), np.array([127, 120]), np.array([1, 7]))
    assert picture[0, 0] == 7
