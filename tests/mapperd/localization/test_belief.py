"""The belief: weight that the best cluster does not explain."""

import math

import numpy as np
import pytest

from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.particle_filter import belief
from tests.mapperd.localization.filter_cases import Floats, filter_at


def cloud(sigma_m: tuple[float, float], turn_rad: float, count: int = 20000) -> Floats:
    random = np.random.default_rng(5)
    along = random.normal(0.0, 1.0, (count, 2)) * sigma_m
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    place = along @ np.array([[c, s], [-s, c]])
    return np.column_stack([place, random.normal(0.0, 0.05, count)])


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, math.pi / 2])
def test_wide_cloud_is_one_mode_whatever_its_axis(turn_rad: float) -> None:
    """Beyond three standard deviations along the longest axis lies next to nothing."""
    within_a_bucket = cloud((1.2, 0.2), turn_rad) + np.array([10.0, 10.0, 0.26])
    found = belief(filter_at(within_a_bucket), bucket_xy_m=20.0)
    assert found.elsewhere < 0.02
    assert not found.ambiguous


def test_weight_a_metre_off_a_narrow_mode_is_elsewhere() -> None:
    poses = cloud((0.05, 0.05), 0.0, 1000)
    poses[:300, 0] += 1.6
    found = belief(filter_at(poses))
    assert found.elsewhere == pytest.approx(0.3)
    assert found.ambiguous
    poses[:300, 0] -= 0.9
    assert belief(filter_at(poses)).elsewhere == pytest.approx(0.0, abs=1e-12)


def test_a_gaussian_s_heading_is_wrapped_and_its_rounding_mended() -> None:
    reported = PlanarGaussian(1, 2, 4.0, np.diag([1.0, -1e-17, 2.0]))
    assert reported.yaw_rad == pytest.approx(4.0 - math.tau)
    assert np.linalg.eigvalsh(reported.covariance)[0] >= 0.0


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_gaussian_of_no_numbers_is_refused(wrong: float) -> None:
    for mean in ((wrong, 0.0, 0.0), (0.0, wrong, 0.0), (0.0, 0.0, wrong)):
        with pytest.raises(ValueError, match="finite"):
            PlanarGaussian(*mean, np.eye(3))
    with pytest.raises(ValueError, match="finite"):
        PlanarGaussian(0, 0, 0, np.diag([1.0, wrong, 1.0]))


def test_a_matrix_that_is_no_covariance_is_refused() -> None:
    leaning = np.eye(3)
    leaning[0, 1] = 0.1
    with pytest.raises(ValueError, match="symmetric"):
        PlanarGaussian(0, 0, 0, leaning)
    with pytest.raises(ValueError, match="semi-definite"):
        PlanarGaussian(0, 0, 0, np.diag([1.0, -0.1, 1.0]))
