import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.gaussian import PlanarGaussian, wrapped
from mapperd.localization.odom_correction import map_from_odom
from mapperd.localization.scan import yaw_of

NUMBERS = st.floats(-1e3, 1e3)
TILTS = st.floats(-80, 80)
YAWS = st.floats(-180, 180)


def at(x: float, y: float, yaw: float) -> PlanarGaussian:
    return PlanarGaussian(x, y, yaw, np.zeros((3, 3)))


@given(
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(TILTS, TILTS, YAWS),
    st.tuples(NUMBERS, NUMBERS, st.floats(-3, 3)),
)
def test_vehicle_comes_to_the_estimate_and_keeps_depth_roll_and_pitch(
    position: tuple[float, float, float],
    rpy: tuple[float, float, float],
    mean: tuple[float, float, float],
) -> None:
    (_, _, z), (roll, pitch, _) = position, rpy
    mean_x, mean_y, mean_yaw = mean
    odom = pose_from_rpy(position, rpy)
    transform = map_from_odom(at(mean_x, mean_y, mean_yaw), odom, 0, 0)
    expected = pose_from_rpy((mean_x, mean_y, z), (roll, pitch, math.degrees(mean_yaw)))
    found = transform.corrected(odom)
    assert found.map_T_base == pytest.approx(expected.map_T_base, abs=1e-9)
    assert found.map_T_base == pytest.approx(transform.map_T_odom @ odom.map_T_base, abs=1e-9)


def test_turn_of_the_correction_is_the_short_way_round() -> None:
    transform = map_from_odom(at(0, 0, 3.0), pose_from_rpy((0, 0, 0), (0, 0, -170)), 0, 0)
    assert transform.yaw_rad == pytest.approx(3.0 + math.radians(170) - math.tau)


def test_correction_is_a_shift_and_a_turn_and_nothing_else() -> None:
    odom = pose_from_rpy((3, -2, -7), (10, -20, 170))
    transform = map_from_odom(at(1, 2, -3), odom, 0, 0).map_T_odom
    assert transform[2].tolist() == [0, 0, 1, 0]
    assert transform[:, 2].tolist() == [0, 0, 1, 0]


def test_it_is_stamped_ahead() -> None:
    odom = pose_from_rpy((0, 0, 0), (0, 0, 0))
    assert map_from_odom(at(0, 0, 0), odom, 10**18, 0.1).stamp_ns == 10**18 + 10**8


def test_no_drift_is_no_correction_whatever_the_sign_of_pi() -> None:
    odom = pose_from_rpy((1, 2, 3), (0, 0, 180))
    for yaw in (math.pi, -math.pi):
        assert map_from_odom(at(1, 2, yaw), odom, 0, 0).map_T_odom == pytest.approx(np.eye(4))


@pytest.mark.parametrize(
    "covariance",
    [
        np.ones((2, 2)),
        np.full((3, 3), np.nan),
        np.diag([1, 1, -0.1]),
        [[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]],
        [[1, 2, 0], [2, 1, 0], [0, 0, 1]],
    ],
)
def test_what_is_no_covariance_is_refused(covariance: object) -> None:
    with pytest.raises(ValueError, match="covariance"):
        PlanarGaussian(0, 0, 0, covariance)  # type: ignore[arg-type]


@pytest.mark.parametrize("covariance", [np.zeros((3, 3)), np.ones((3, 3)), np.diag([1, 1, -1e-18])])
def test_rounding_is_mended(covariance: object) -> None:
    mended = PlanarGaussian(0, 0, 0, covariance).covariance  # type: ignore[arg-type]
    assert np.linalg.eigvalsh(mended)[0] >= -1e-15
    assert mended == pytest.approx(np.asarray(covariance))


def test_pose_that_is_not_finite_is_refused_and_headings_are_wrapped() -> None:
    with pytest.raises(ValueError, match="finite"):
        at(math.nan, 0, 0)
    assert at(0, 0, 3 * math.pi + 0.1).yaw_rad == pytest.approx(-math.pi + 0.1)
    assert abs(wrapped(math.pi + 1e-9)) <= math.pi


def test_heading_of_a_steep_vehicle_is_that_of_its_nose() -> None:
    assert yaw_of(pose_from_rpy((0, 0, 0), (170, 30, 40)).map_q_base) == pytest.approx(
        math.radians(40)
    )
