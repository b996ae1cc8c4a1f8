import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mapperd.geometry.frames import (
    BODY_TO_FLU,
    WORLD_TO_ENU,
    Body,
    Pose,
    World,
    compass_quaternion,
    compass_to_map,
    orientation_to_map,
    pose_from_rpy,
    quaternion_between,
    quaternion_product,
    quaternion_to_matrix,
    rotation_from_rpy,
)

IDENTITY = (1.0, 0.0, 0.0, 0.0)
DOWN_FACING = pose_from_rpy((0, 0, -0.5), (0, 90, 0)).map_T_base


def beam(range_m: float, bearing_deg: float, elevation_deg: float) -> list[float]:
    """A point of the sonar frame, as the published formulas have it; homogeneous."""
    b, e = math.radians(bearing_deg), math.radians(elevation_deg)
    across = range_m * math.cos(e)
    return [across * math.cos(b), -across * math.sin(b), range_m * math.sin(e), 1]


@st.composite
def rotations(draw: st.DrawFn) -> np.ndarray:
    numbers = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 4)))
    assume(np.linalg.norm(numbers) > 0.1)
    return np.asarray(numbers / np.linalg.norm(numbers))


def test_golden_points_of_a_sonar_that_looks_down() -> None:
    assert DOWN_FACING @ beam(5, 30, 0) == pytest.approx([0, -2.5, -4.8301, 1], abs=1e-4)
    assert DOWN_FACING @ beam(5, 0, 10) == pytest.approx([0.8682, 0, -5.4240, 1], abs=1e-4)


def test_positive_bearing_is_to_starboard() -> None:
    ahead = pose_from_rpy((0, 0, 0), (0, 0, 0)).map_T_base
    assert (ahead @ beam(1, 30, 0))[1] < 0


def test_yaw_turns_to_port_pitch_turns_the_nose_down_roll_turns_starboard_down() -> None:
    nose = [1, 0, 0]
    port = [0, 1, 0]
    yawed = quaternion_to_matrix(rotation_from_rpy(0, 0, 90))
    pitched = quaternion_to_matrix(rotation_from_rpy(0, 90, 0))
    rolled = quaternion_to_matrix(rotation_from_rpy(90, 0, 0))
    assert yawed @ nose == pytest.approx([0, 1, 0])
    assert pitched @ nose == pytest.approx([0, 0, -1])
    assert rolled @ port == pytest.approx([0, 0, 1])


def test_rotation_order_is_yaw_after_pitch_after_roll() -> None:
    together = quaternion_to_matrix(rotation_from_rpy(10, 20, 30))
    roll, pitch, yaw = (
        quaternion_to_matrix(rotation_from_rpy(*angles))
        for angles in ((10, 0, 0), (0, 20, 0), (0, 0, 30))
    )
    assert together == pytest.approx(yaw @ pitch @ roll)
    assert not np.allclose(together, roll @ pitch @ yaw)


@pytest.mark.parametrize(
    ("compass_deg", "map_deg"), [(0, 90), (90, 0), (180, -90), (359, 91), (315, 135), (225, -135)]
)
def test_compass_is_clockwise_from_north(compass_deg: float, map_deg: float) -> None:
    assert compass_to_map(compass_deg) == pytest.approx(math.radians(map_deg))


def test_angles_of_a_vehicle_are_starboard_down_nose_up_clockwise() -> None:
    east = quaternion_to_matrix(compass_quaternion(0, 0, 90))
    assert east[:, 0] == pytest.approx([1, 0, 0])
    nose_up = quaternion_to_matrix(compass_quaternion(0, 30, 0))
    assert nose_up[:, 0] == pytest.approx([0, math.sqrt(0.75), 0.5])
    starboard_down = quaternion_to_matrix(compass_quaternion(30, 0, 90))
    assert starboard_down[:, 1] == pytest.approx([0, math.sqrt(0.75), 0.5])


def test_quaternion_is_w_first() -> None:
    half = math.sqrt(0.5)
    about_z = quaternion_to_matrix((half, 0, 0, half))
    assert about_z @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert quaternion_to_matrix(IDENTITY) == pytest.approx(np.eye(3))


@given(rotations(), rotations())
def test_product_of_quaternions_is_product_of_matrices(a: np.ndarray, b: np.ndarray) -> None:
    product = quaternion_to_matrix(quaternion_product(a, b))
    assert product == pytest.approx(quaternion_to_matrix(a) @ quaternion_to_matrix(b), abs=1e-12)


def test_ned_is_north_east_down() -> None:
    north, east, down = WORLD_TO_ENU["ned"] @ np.eye(3)
    to_enu = WORLD_TO_ENU["ned"]
    assert to_enu @ [1, 0, 0] == pytest.approx([0, 1, 0])  # north is our y
    assert to_enu @ [0, 1, 0] == pytest.approx([1, 0, 0])  # east is our x
    assert to_enu @ [0, 0, 1] == pytest.approx([0, 0, -1])
    assert np.linalg.det(np.array([north, east, down])) == pytest.approx(1)


def test_frd_is_forward_right_down() -> None:
    to_flu = BODY_TO_FLU["frd"]
    assert to_flu @ [1, 0, 0] == pytest.approx([1, 0, 0])
    assert to_flu @ [0, 1, 0] == pytest.approx([0, -1, 0])
    assert to_flu @ [0, 0, 1] == pytest.approx([0, 0, -1])


def test_ned_frd_identity_points_north_and_upright() -> None:
    matrix = quaternion_to_matrix(orientation_to_map(IDENTITY, "ned", "frd"))
    assert matrix @ [1, 0, 0] == pytest.approx([0, 1, 0])  # forward is north
    assert matrix @ [0, 0, 1] == pytest.approx([0, 0, 1])  # up is up


def test_ned_yaw_of_90_degrees_points_east() -> None:
    half = math.sqrt(0.5)
    matrix = quaternion_to_matrix(orientation_to_map((half, 0, 0, half), "ned", "frd"))
    assert matrix @ [1, 0, 0] == pytest.approx([1, 0, 0])


def test_frd_nose_up_is_our_nose_up() -> None:
    nose_up = (math.cos(0.1), 0, math.sin(0.1), 0)  # FRD: y to the right, so positive lifts
    matrix = quaternion_to_matrix(orientation_to_map(nose_up, "ned", "frd"))
    assert (matrix @ [1, 0, 0])[2] == pytest.approx(math.sin(0.2))


@given(rotations(), st.sampled_from(["enu", "ned"]), st.sampled_from(["flu", "frd"]))
def test_orientation_converts_as_its_matrices_do(
    quaternion: np.ndarray, world: World, body: Body
) -> None:
    ours = quaternion_to_matrix(orientation_to_map(quaternion, world, body))
    theirs = quaternion_to_matrix(quaternion)
    assert ours == pytest.approx(WORLD_TO_ENU[world] @ theirs @ BODY_TO_FLU[body].T, abs=1e-12)


def test_interpolation_takes_the_shorter_way_whatever_the_sign() -> None:
    start, end = rotation_from_rpy(0, 0, 170), rotation_from_rpy(0, 0, -170)
    for sign in (1, -1):
        middle = quaternion_to_matrix(quaternion_between(start, sign * end, 0.5))
        assert middle @ [1, 0, 0] == pytest.approx([-1, 0, 0], abs=1e-12)


@pytest.mark.parametrize("span_deg", [0.0, 1e-6, 1.0, 3.0, 5.0, 90.0, 179.0])
@pytest.mark.parametrize("fraction", [-0.5, 0.0, 0.25, 1.0, 1.5])
def test_turn_goes_on_at_constant_rate(span_deg: float, fraction: float) -> None:
    end = rotation_from_rpy(0, 0, span_deg)
    turned = quaternion_between(IDENTITY, end, fraction)
    assert np.linalg.norm(turned) == pytest.approx(1)
    expected = quaternion_to_matrix(rotation_from_rpy(0, 0, fraction * span_deg))
    assert quaternion_to_matrix(turned) == pytest.approx(expected, abs=1e-4)


@given(rotations(), rotations(), st.floats(-1, 2))
def test_interpolation_is_always_a_rotation(a: np.ndarray, b: np.ndarray, fraction: float) -> None:
    assert np.linalg.norm(quaternion_between(a, b, fraction)) == pytest.approx(1)


def test_opposite_orientations_have_a_finite_middle() -> None:
    middle = quaternion_between(IDENTITY, (0.0, 0.0, 0.0, 1.0), 0.5)
    assert np.isfinite(middle).all()


def test_pose_owns_its_arrays() -> None:
    position = np.zeros(3)
    pose = Pose(position, np.array(IDENTITY))
    position[0] = 5
    assert pose.position_m[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        pose.position_m[0] = 1


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [
        ([0, 0], IDENTITY),
        ([0, 0, 0], (1, 0, 0)),
        ([math.nan, 0, 0], IDENTITY),
        ([0, 0, 0], (0, 0, 0, 0)),
        ([0, 0, 0], (2, 0, 0, 0)),
        ([0, 0, 0], (math.nan, 0, 0, 0)),
    ],
)
def test_what_is_no_pose_is_refused(position: list[float], quaternion: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="a pose is"):
        Pose(np.array(position), np.array(quaternion))
