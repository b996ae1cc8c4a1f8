"""Hard cases of the fusion of odometry: orientations and headings."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.odometry import WorldInitConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import (
    compass_to_map,
    quaternion_between,
    quaternion_product,
    quaternion_to_matrix,
    rotation_from_rpy,
)
from mapperd.localization.scan import level_T_base, yaw_of
from mapperd.odometry.fusion import Fusion
from mapperd.odometry.levelling import Levelling
from mapperd.odometry.native import NativeRecord, odometry_of
from mapperd.odometry.records import Odometry
from mapperd.odometry.states import Attitude, carry_attitude, turn_between
from tests.mapperd.odometry.conftest import T0, S, fused_at, record
from tests.mapperd.odometry.conftest import yaw_of as yaw_of_fused

Floats = NDArray[np.float64]
ODD = np.array(rotation_from_rpy(17.0, -61.0, 139.0))
AXIS = np.array([0.36, -0.48, 0.8])


def about(angle_rad: float, axis: Floats = AXIS) -> Floats:
    """A turn, by 40 digits."""
    with mp.workdps(40):
        half = mp.mpf(angle_rad) / 2
        parts = [mp.cos(half), *(mp.mpf(float(x)) * mp.sin(half) for x in axis)]
    return np.array([float(part) for part in parts])


def apart_rad(a: Floats, b: Floats) -> float:
    """Angle between two orientations, sharp near 0, whatever their signs."""
    near = min(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))
    return 4.0 * math.asin(min(near / 2.0, 1.0))


def off_orthonormal(matrix: Floats) -> float:
    return float(np.abs(matrix @ matrix.T - np.eye(3)).max())


def native(q: tuple[float, float, float, float]) -> Odometry | Reject:
    return odometry_of(NativeRecord(v=1, clk="arrival", w="ned", b="frd", q=q))


def test_unnormalised_quaternion_of_a_sender() -> None:
    """Written with three digits, a quaternion is made one; further from 1 it is refused.

    Naively its matrix stretches the map by twice the error of the norm: 1 % is 20 cm at 10 m.
    """
    for size in (0.991, 1.0, 1.009):
        taken = native(tuple(size * ODD))
        assert isinstance(taken, Odometry)
        assert taken.map_q_base is not None
        assert off_orthonormal(quaternion_to_matrix(taken.map_q_base)) < 1e-15
    refused = native(tuple(1.011 * ODD))
    assert isinstance(refused, Reject)
    assert refused.reason == "unnormalised_quaternion"


@pytest.mark.parametrize("size", [0.0, 1e-320, 1e-9])
def test_zero_quaternion(size: float) -> None:
    """Four zeros, as of a filter that has not begun, are not an orientation.

    Naively they are divided by their norm: 0 / 0 is NaN, and NaN is in every voxel of that ping.
    """
    refused = native((size, 0.0, 0.0, 0.0))
    assert isinstance(refused, Reject)
    assert refused.reason == "zero_quaternion"


@pytest.mark.parametrize(
    "wrong",
    [
        {"map_q_base": np.array([np.nan, 0, 0, 0])},
        {"map_q_base": np.zeros(4)},
        {"map_q_base": 2.0 * ODD},
        {"position_m": np.array([0, np.inf, 0])},
        {"position_m": np.array([1e300, 0, 0])},
        {"rate_radps": np.full(3, np.nan)},
        {"velocity_mps": np.full(3, np.nan)},
        {"velocity_map_mps": np.full(3, -np.inf)},
        {"pose_covariance": np.full((6, 6), np.nan)},
        {"depth_m": math.nan},
        {"heading_rad": math.inf},
    ],
    ids=" ".join,
)
def test_record_that_holds_no_number(wrong: dict[str, Floats | float]) -> None:
    """A record with a NaN is refused whole, as the first one too, and poses are made of the others.

    Naively the first value of a series has nothing to be compared with and is taken: then every
    pose beside it is NaN, and as NaN follows from nothing, all records after it are jumps.
    """
    fusion = Fusion()
    for k in range(20):
        good = {"position_m": np.zeros(3), "map_q_base": ODD, "depth_m": 1.0}
        reject = fusion.take("ekf", record(**(good | (wrong if k % 5 == 0 else {}))), T0 + k * S)
        assert (reject is not None) == (k % 5 == 0), reject
    assert fusion.rejects["ekf"].total() == 4
    assert fused_at(fusion, 8.0).pose.map_q_base == pytest.approx(ODD, abs=1e-15)


def test_q_and_minus_q_are_one_orientation() -> None:
    """Between q and -q nothing turns, at any fraction.

    Naively half way between them is the zero quaternion, or the vehicle spins once around.
    """
    for fraction in (-1.0, 0.0, 0.25, 0.5, 1.0, 2.0):
        assert apart_rad(quaternion_between(ODD, -ODD, fraction), ODD) < 1e-15
    assert turn_between(ODD, -ODD) == pytest.approx(np.zeros(3), abs=1e-15)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-300, 1e-16, 1e-8, 1e-4, 0.06])
@pytest.mark.parametrize("fraction", [-0.5, 0.3, 1.5])
def test_slerp_of_nearly_equal_orientations(angle_rad: float, fraction: float) -> None:
    """Between near orientations the turn is even to a microradian, and beyond them to 14.

    Naively both sines are divided by the sine of the angle: 0 / 0 where the vehicle stands still,
    and the arc cosine of a number rounded above 1 is NaN.
    """
    end = quaternion_product(ODD, about(angle_rad))
    expected = quaternion_product(ODD, about(fraction * angle_rad))
    got = quaternion_between(ODD, end, fraction)
    assert apart_rad(got, expected) < (1e-6 if 0 < fraction < 1 else 1.4e-5)
    assert abs(np.linalg.norm(got) - 1) < 1e-15


@pytest.mark.parametrize("short_of_pi", [0.0, 1e-15, 1e-9, 1e-3, -1e-9])
def test_slerp_of_opposite_orientations(short_of_pi: float) -> None:
    """Half a revolution apart, the middle is a quarter from both ends, whichever way it went.

    Naively the chord goes through zero, or its sign is decided by rounding and the way is 3/4 long.
    """
    end = quaternion_product(ODD, about(math.pi - short_of_pi))
    middle = quaternion_between(ODD, end, 0.5)
    assert abs(np.linalg.norm(middle) - 1) < 1e-15
    for side in (ODD, end):
        assert apart_rad(middle, side) == pytest.approx(math.pi / 2, abs=abs(short_of_pi) + 1e-9)


def test_turn_of_half_a_revolution() -> None:
    """The way from one attitude to another is never longer than half a revolution.

    Naively 2 acos(w) gives up to a whole one, and near w = 1 loses half of all digits.
    """
    for angle in (math.pi - 1e-9, math.pi + 1e-9, 3.0 * math.pi / 2, 2 * math.pi - 1e-8):
        turn = turn_between(ODD, quaternion_product(ODD, about(angle)))
        assert turn @ AXIS == pytest.approx(math.remainder(angle, math.tau), abs=1e-14)
    half = turn_between(ODD, quaternion_product(ODD, about(math.pi)))
    assert np.linalg.norm(half) == pytest.approx(math.pi, abs=1e-14)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-200, 1e-12, 1e-7, 1e-3])
def test_rate_of_a_vehicle_that_hardly_turns(angle_rad: float) -> None:
    """A turn of nanoradians keeps its size and axis, there and back.

    Naively the axis is divided by the sine of no angle, or the arc cosine makes 1e-8 rad a zero.
    """
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    carried = carry_attitude(Attitude(identity, angle_rad * AXIS, np.eye(3)), 1.0)
    assert carried is not None
    assert apart_rad(carried.map_q_base, about(angle_rad)) <= 1e-15
    turn = turn_between(identity, carried.map_q_base)
    assert turn == pytest.approx(angle_rad * AXIS, rel=1e-14, abs=1e-199)


def test_attitude_carried_on_ten_thousand_times() -> None:
    """Small turns one after the other stay a rotation, and add up.

    Naively each product leaves the norm an ulp off: after hours the matrix stretches and shears.
    """
    step, count = 0.003, 10_000
    attitude = Attitude(ODD, step * AXIS, np.eye(3))
    for _ in range(count):
        carried = carry_attitude(attitude, 1.0)
        assert carried is not None
        attitude = carried
    expected = quaternion_product(ODD, about(float(mp.fmod(mp.mpf(step) * count, 4 * mp.pi))))
    assert abs(np.linalg.norm(attitude.map_q_base) - 1) < 4e-16
    assert apart_rad(attitude.map_q_base, expected) < 1e-12
    assert off_orthonormal(quaternion_to_matrix(attitude.map_q_base)) < 1e-15


def test_a_thousand_jumps_of_the_estimate() -> None:
    """Each time the estimate jumps the map's frame is carried over, and its errors do not add up.

    Naively each jump multiplies one more rotation onto the last: the norm drifts, and angles shear.
    """
    fusion, chance = Fusion(), np.random.default_rng(4)
    for k in range(1000):
        turn = rotation_from_rpy(0.0, 0.0, chance.uniform(-180, 180))
        fields = {
            "map_q_base": quaternion_product(turn, ODD),
            "position_m": chance.uniform(-1e4, 1e4, 3),
            "reset_count": k // 2,
        }
        fusion.take("slam", record(**fields), T0 + k * S // 10)
    fused = fused_at(fusion, 99.9)
    first = fused.pose.map_q_base
    assert fused.segment > 500
    assert abs(float(first @ first) - 1) < 1e-12
    assert off_orthonormal(quaternion_to_matrix(first)) < 1e-12


def test_heading_between_179_and_181_degrees() -> None:
    """Between two headings on both sides of pi the vehicle turns by 2 degrees.

    Naively their mean as numbers is 0: in the middle of the gap the sonar looks the other way.
    """
    fusion = Fusion()
    for k, heading in enumerate((math.pi - 0.02, -math.pi + 0.02)):
        fields = {"heading_rad": heading, "position_m": np.zeros(3)}
        fusion.take("compass", record(**fields), T0 + k * S // 5)
    assert abs(yaw_of_fused(fused_at(fusion, 0.1))) == pytest.approx(math.pi, abs=1e-12)
    quarter = yaw_of_fused(fused_at(fusion, 0.05))
    assert math.remainder(quarter, math.tau) == pytest.approx(math.pi - 0.01, abs=1e-6)


@pytest.mark.parametrize("turns", [0, 1, -1, 1000, 10**6])
def test_compass_heading_of_many_turns(turns: int) -> None:
    """A heading that was never wrapped is the same direction, within -pi to pi.

    Naively 3.6e8 degrees are kept as they are: comparisons see a jump, and filters average turns.
    """
    for heading in (0.0, 89.5, 179.999, 270.0):
        got = compass_to_map(heading + 360.0 * turns)
        with mp.workdps(30):
            exact = mp.radians(90 - mp.mpf(heading) - 360 * mp.mpf(turns))
            error = mp.fmod(mp.mpf(got) - exact + mp.pi, 2 * mp.pi) - mp.pi
        assert -math.pi <= got <= math.pi
        assert abs(math.remainder(float(error), math.tau)) < 1e-7


@pytest.mark.parametrize("pitch_deg", [90.0, -90.0, 89.9999999])
def test_vehicle_on_its_nose(pitch_deg: float) -> None:
    """Straight up or down there is no heading; some heading is taken, and the rest is a rotation.

    Naively the angles come of atan2(0, 0) and arc sines of numbers above 1.
    """
    q = rotation_from_rpy(0.0, pitch_deg, 33.0)
    assert math.isfinite(yaw_of(q))
    level = level_T_base(q)[:3, :3]
    assert off_orthonormal(level) < 1e-15
    assert (level @ np.array([1.0, 0, 0]))[2] == pytest.approx(-math.copysign(1, pitch_deg))


@pytest.mark.parametrize("tilt_rad", [0.0, 1e-16, 1e-6, 4e-5, 5e-5, 1e-3])
def test_levelling_of_a_world_upside_down(tilt_rad: float) -> None:
    """Gravity that points up is turned to down about some level axis, to 50 microradians.

    Naively the axis is the cross product of two opposite vectors, which is zero, divided by itself.
    """
    level = Levelling(WorldInitConfig(enabled=True, init_samples=1))
    force = 9.81 * np.array([math.sin(tilt_rad) * 0.6, math.sin(tilt_rad) * 0.8, -1.0])
    assert level.add(force, None, np.array([1.0, 0, 0, 0])) is None
    assert level.level_q_odometry is not None
    matrix = quaternion_to_matrix(level.level_q_odometry)
    up = matrix @ (force / np.linalg.norm(force))
    assert off_orthonormal(matrix) < 2e-15
    assert math.hypot(up[0], up[1]) < 5e-5
    assert up[2] > 0
