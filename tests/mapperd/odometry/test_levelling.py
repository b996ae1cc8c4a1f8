"""The tilt from gravity, against rotations chosen beforehand."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from mapperd.config.odometry import WorldInitConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_to_matrix, rotation_from_rpy
from mapperd.odometry.fusion import Fusion
from mapperd.odometry.levelling import Levelling, levelled
from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry
from tests.mapperd.odometry.conftest import T0, S, feed, fused_at

ON = WorldInitConfig(enabled=True)
UP = np.array([0.0, 0.0, 9.81])


@pytest.mark.parametrize(
    "rpy_deg", [(0, 0, 0), (5, 5, 0), (20, -20, 0), (0, 0, 130), (-35, 50, 170), (180, 0, 0)]
)
def test_any_tilt_is_undone_exactly(rpy_deg: tuple[float, float, float]) -> None:
    """The published one left 1.7 degrees at 20/20: it negated angles."""
    true_q_base = rotation_from_rpy(*rpy_deg)  # of the vehicle in the level world
    odometry_q_base = np.array([1.0, 0.0, 0.0, 0.0])  # its own world began with itself
    levelling = Levelling(ON)
    force = quaternion_to_matrix(true_q_base).T @ UP
    for _ in range(50):
        assert levelling.add(force, np.zeros(3), odometry_q_base) is None
    assert levelling.level_q_odometry is not None
    upright = quaternion_to_matrix(levelled(levelling.level_q_odometry, odometry_q_base))
    # The body's up axis is where it truly is; the heading is free.
    assert pytest.approx(quaternion_to_matrix(true_q_base).T @ [0, 0, 1]) == upright.T @ [0, 0, 1]


def test_a_moving_vehicle_is_refused_and_starts_again() -> None:
    levelling = Levelling(ON)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(49):
        levelling.add(UP, np.zeros(3), level)
    cases = (
        (UP, np.radians([0, 0, 3.0]), "turns at 3.0 deg/s; at most 2"),
        (UP * 1.2, np.zeros(3), "an acceleration of 11.77 m/s2 is not gravity alone"),
    )
    for force, rate, why in cases:
        assert levelling.add(force, rate, level) == Reject("moving", why)
        assert levelling.level_q_odometry is None
    assert levelling.refused == 51
    drives = levelling.add(UP, None, level, 0.2)
    assert isinstance(drives, Reject)
    assert drives.reason == "moving"
    assert "0.20 m/s" in drives.detail
    levelling.add(UP, None, level)
    assert levelling.add(UP * 1.05, None, level) == Reject(
        "moving", "accelerations differ by 0.49 m/s2"
    )
    assert levelling.pending is not None
    assert levelling.pending.detail.startswith("0 of 50")


def test_shaking_about_another_direction_is_no_standing_still() -> None:
    """Swinging gravity keeps its magnitude: only its direction changes."""
    levelling = Levelling(ON)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(50):
        swung = quaternion_to_matrix(rotation_from_rpy(10.0 * (-1) ** k, 0, 0)) @ UP
        levelling.add(swung, None, level)
    assert levelling.level_q_odometry is None


def test_nothing_is_mapped_before_the_world_is_level_and_all_is_turned_after() -> None:
    settings = msgspec.structs.replace(ON, init_samples=10)
    fusion = Fusion(world_init=settings)
    tilt = rotation_from_rpy(0, 30, 0)
    fields = {
        "position_m": np.array([2.0, 1.0, 0.0]),
        "map_q_base": np.array([1.0, 0.0, 0.0, 0.0]),
        "velocity_map_mps": np.zeros(3),
        "rate_radps": np.zeros(3),
        "specific_force_mps2": quaternion_to_matrix(tilt).T @ UP,
    }
    feed(fusion, "ekf", 10, 0.5, lambda _: fields)
    reject = fusion.at(T0)
    assert isinstance(reject, Reject)
    assert (reject.reason, reject.detail[:7]) == ("levelling", "6 of 10")
    feed(fusion, "ekf", 10, 2.0, lambda _: fields, start_s=0.6)
    fused = fused_at(fusion, 1.0)
    assert abs(float(fused.pose.map_q_base @ tilt)) == pytest.approx(1)
    assert fused.pose.position_m == pytest.approx(quaternion_to_matrix(tilt) @ [2.0, 1.0, 0.0])
    assert fusion.at(T0 + 5 * S) != fused
    ahead = {**fields, "velocity_map_mps": np.array([0.2, 0.0, 0.1])}
    feed(fusion, "ekf", 10, 3.0, lambda _: ahead, start_s=2.1)
    moving = fused_at(fusion, 2.8).velocity_mps
    assert moving == pytest.approx(quaternion_to_matrix(tilt) @ [0.2, 0.0, 0.1])


@pytest.mark.parametrize(("body", "at_rest"), [("flu", (0, 0, 9.81)), ("frd", (0, 0, -9.81))])
def test_native_records_carry_accelerations_in_either_axes(
    body: str, at_rest: tuple[float, ...], odometry_bytes: Callable[..., bytes]
) -> None:
    odometry = decode_native(odometry_bytes(b=body, a=tuple(map(float, at_rest))))
    assert isinstance(odometry, Odometry)
    assert odometry.specific_force_mps2 == pytest.approx([0, 0, 9.81])


def test_the_turn_of_levelling_has_an_exact_inverse_and_is_reported() -> None:
    levelling = Levelling(msgspec.structs.replace(ON, init_samples=1))
    assert Levelling(WorldInitConfig()).status() is None
    levelling.add(quaternion_to_matrix(rotation_from_rpy(35, -40, 0)).T @ UP, None, np.eye(4)[0])
    reported = levelling.status()
    assert reported is not None
    assert (reported["parent_frame"], reported["child_frame"]) == ("world_init", "camera_init")
    level = quaternion_to_matrix(reported["parent_q_child"])
    assert level @ level.T == pytest.approx(np.eye(3), abs=1e-15)
