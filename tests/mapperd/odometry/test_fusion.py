"""Poses from several sources, against a circle driven in closed form."""

from __future__ import annotations

from unittest.mock import ANY

import msgspec
import numpy as np
import pytest

from mapperd.config.odometry import (
    DeadReckoningConfig,
    GeoOriginConfig,
    LimitsConfig,
    OdometryFusionConfig,
    OdometrySourceConfig,
    OwnersConfig,
    TimeSyncConfig,
)
from mapperd.errors import Reject
from mapperd.geometry.frames import rotation_from_rpy
from mapperd.odometry.fusion import FusedPose, Fusion
from mapperd.odometry.records import GeoPoint, Odometry
from tests.mapperd.odometry.conftest import T0, Circle, S, feed, fused_at, record, yaw_of

OWNERS = OdometryFusionConfig(
    sources=tuple(OdometrySourceConfig(name=name) for name in ("ekf", "ahrs", "bar30", "dvl")),
    owners=OwnersConfig("ekf", "ahrs", "bar30", "dvl"),
)


def body_velocity(circle: Circle) -> np.ndarray:
    return np.array([circle.speed_mps, 0.0, 0.0])


def reason_at(fusion: Fusion, t_s: float) -> str:
    reject = fusion.at(T0 + round(t_s * S))
    assert isinstance(reject, Reject), reject
    return reject.reason


def test_each_quantity_comes_from_its_owner(circle: Circle) -> None:
    fusion = Fusion(OWNERS)
    wrong = {"position_m": np.zeros(3), "map_q_base": np.array([0.0, 0.0, 0.0, 1.0])}
    feed(fusion, "ahrs", 50, 2, lambda t: {**wrong, "map_q_base": circle.quaternion(t)})
    feed(fusion, "ekf", 10, 2, lambda t: {**wrong, "position_m": circle.position_m(t)})
    feed(fusion, "bar30", 5, 2, lambda _: {"depth_m": 7.0})
    fused = fused_at(fusion, 1.03)
    assert fused.pose.position_m[:2] == pytest.approx(circle.position_m(1.03)[:2], abs=5e-4)
    assert fused.pose.position_m[2] == pytest.approx(-7.0)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(1.03), abs=1e-6)
    owners = {name: one["owner"] for name, one in fusion.status()["quantities"].items()}
    assert owners == {"position": "ekf", "attitude": "ahrs", "depth": "bar30", "velocity": None}


def test_the_newest_depth_and_attitude_are_known_without_a_pose(circle: Circle) -> None:
    fusion = Fusion(OWNERS)
    assert fusion.status()["newest"] == {"depth_m": None, "map_q_base_wxyz": None}
    assert fusion.status()["north_referenced"] is False
    feed(fusion, "ahrs", 50, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "bar30", 5, 1, lambda t: {"depth_m": 7.0 + t})
    assert reason_at(fusion, 0.5) == "no_position"
    newest = fusion.status()["newest"]
    assert newest["depth_m"] == pytest.approx(8.0)
    assert newest["map_q_base_wxyz"] == pytest.approx(circle.quaternion(1.0))
    assert fusion.status()["north_referenced"] is True
    other = Fusion(OWNERS)
    turn = {"map_q_base": circle.quaternion(0.0), "north_referenced": False}
    feed(other, "ahrs", 50, 1, lambda _: turn)
    assert other.status()["north_referenced"] is False


def test_without_configuration_the_first_to_report_it_owns_it(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "one", 20, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "two", 20, 1, lambda t: {"position_m": circle.position_m(t)})
    assert fusion.take("three", record(position_m=np.zeros(3)), T0 + 2 * S) == Reject(
        "other_source", ANY
    )
    assert fused_at(fusion, 0.5).pose.position_m == pytest.approx(circle.position_m(0.5), abs=1e-3)
    assert fusion.rejects == {"three": {"other_source": 1}}


def test_dead_reckoning_follows_the_circle(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 100, 20, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 20, lambda _: {"velocity_mps": body_velocity(circle)})
    for t_s in (0.5, 7.33, 19.9):
        fused = fused_at(fusion, t_s)
        # The trapezoid rule over 0.1 s: h²/12 of the second derivative, 0.2² m/s³, over the way.
        assert fused.pose.position_m[:2] == pytest.approx(circle.position_m(t_s)[:2], abs=2e-3)
        assert fused.velocity_mps == pytest.approx(circle.velocity_map_mps(t_s), abs=1e-3)
        assert fused.rate_radps == pytest.approx([0, 0, circle.rate_radps], abs=1e-6)


def test_velocities_wait_for_attitudes_that_come_later(circle: Circle) -> None:
    fusion = Fusion()
    velocity = body_velocity(circle)
    feed(fusion, "ahrs", 10, 0, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 5, lambda _: {"velocity_mps": velocity})
    feed(fusion, "ahrs", 10, 5, lambda t: {"map_q_base": circle.quaternion(t)}, start_s=0.1)
    assert fused_at(fusion, 4.5).pose.position_m[:2] == pytest.approx(
        circle.position_m(4.5)[:2], abs=2e-3
    )


def test_reckoning_takes_over_from_a_silent_position_and_its_doubt_grows(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 50, 12, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 12, lambda _: {"velocity_mps": body_velocity(circle)})
    feed(fusion, "ekf", 10, 2, lambda t: {"position_m": circle.position_m(t)})
    sure, doubtful = fused_at(fusion, 1.95), fused_at(fusion, 11.0)
    assert doubtful.pose.position_m == pytest.approx(circle.position_m(11.0), abs=5e-3)
    assert sure.reckoned_s == 0.0
    assert doubtful.reckoned_s == pytest.approx(9.0)
    # noise² per second, on top of the position's own variance
    grown = doubtful.covariance[0, 0] - sure.covariance[0, 0]
    assert grown == pytest.approx(0.05**2 * 9.0)
    assert reason_at(Fusion(), 1.0) == "no_odometry"


def test_reckoning_ends_after_its_time(circle: Circle) -> None:
    fusion = Fusion(OdometryFusionConfig(dead_reckoning=DeadReckoningConfig(max_sec=3.0)))
    feed(fusion, "ekf", 10, 1, lambda t: {"position_m": circle.position_m(t)})
    feed(fusion, "ahrs", 50, 6, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 6, lambda _: {"velocity_mps": body_velocity(circle)})
    assert isinstance(fusion.at(T0 + round(3.9 * S)), FusedPose)
    assert reason_at(fusion, 4.2) == "after_odometry"


def test_a_lost_bottom_lock_breaks_the_way(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 50, 5, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "ekf", 10, 1, lambda t: {"position_m": circle.position_m(t)})
    feed(fusion, "dvl", 10, 2, lambda _: {"velocity_mps": body_velocity(circle)})
    lost = record(valid=False)
    assert fusion.take("dvl", lost, T0 + round(2.1 * S)) == Reject("no_lock", ANY)
    feed(fusion, "dvl", 10, 5, lambda _: {"velocity_mps": body_velocity(circle)}, start_s=2.2)
    assert isinstance(fusion.at(T0 + round(1.9 * S)), FusedPose)
    assert reason_at(fusion, 4.0) == "after_odometry"


@pytest.mark.parametrize(
    ("policy", "expected_s"), [("interpolate", 1.034), ("nearest", 1.0), ("latest", 1.1)]
)
def test_policies_choose_the_record(circle: Circle, policy: str, expected_s: float) -> None:
    settings = msgspec.structs.replace(TimeSyncConfig(), policy=policy)
    fusion = Fusion(time_sync=settings)
    feed(fusion, "ekf", 10, 1.1, circle.pose)
    fused = fused_at(fusion, 1.034)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(expected_s), abs=1e-7)
    assert fused.pose.position_m == pytest.approx(circle.position_m(expected_s), abs=3e-4)
    feed(fusion, "ekf", 10, 1.2, circle.pose, start_s=1.2)
    if policy == "latest":
        assert reason_at(fusion, 1.034) == "odometry_gap"  # the newest is 0.166 s away


def test_velocity_carries_positions_on_beyond_the_newest(circle: Circle) -> None:
    fusion = Fusion()
    feed(
        fusion,
        "ekf",
        10,
        1,
        lambda t: {
            "position_m": circle.position_m(t),
            "map_q_base": circle.quaternion(t),
            "velocity_map_mps": circle.velocity_map_mps(t),
            "rate_radps": np.array([0, 0, circle.rate_radps]),
        },
    )
    fused = fused_at(fusion, 1.08)
    # Straight on for 80 ms: v² t² / 2r off the circle.
    assert fused.pose.position_m == pytest.approx(circle.position_m(1.08), abs=7e-4)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(1.08), abs=1e-9)


def test_one_stray_record_is_dropped_and_two_that_agree_are_a_jump(circle: Circle) -> None:
    fusion = Fusion(OdometryFusionConfig(at_jump="follow"))
    feed(fusion, "ekf", 10, 1, circle.pose)
    stray = record(position_m=np.array([50.0, 0, 0]), map_q_base=circle.quaternion(1.1))
    fusion.take("ekf", stray, T0 + round(1.1 * S))
    feed(fusion, "ekf", 10, 2, circle.pose, start_s=1.2)
    assert fusion.status()["quantities"]["position"]["rejected"] == {"jump": 1}
    assert fused_at(fusion, 1.5).segment == 0
    moved = np.array([20.0, 0.0, 0.0])

    def moved_too(t: float) -> dict[str, object]:
        return {**circle.pose(t), "position_m": circle.position_m(t) + moved}

    feed(fusion, "ekf", 10, 3, moved_too, start_s=2.1)
    after = fused_at(fusion, 2.5)
    assert after.segment == 1
    assert after.pose.position_m == pytest.approx(circle.position_m(2.5) + moved, abs=1e-3)
    for t_s in np.arange(2.0, 2.2, 0.01):  # nothing is placed between the two worlds
        displacement_m = np.linalg.norm(
            fused_at(fusion, t_s).pose.position_m - circle.position_m(t_s)
        )
        assert min(displacement_m, abs(displacement_m - 20.0)) < 0.01


@pytest.mark.parametrize("by_counter", [True, False])
def test_a_jump_of_the_estimate_is_no_motion_of_the_vehicle(
    circle: Circle, *, by_counter: bool
) -> None:
    """The source restarts at zero, facing its own x: the map continues where it was."""
    fusion = Fusion()
    jump_s = 8.0  # 92 degrees around

    def source_record(t: float) -> dict[str, object]:
        if t < jump_s:
            return {"position_m": circle.position_m(t), "map_q_base": circle.quaternion(t)}
        again = t - jump_s
        return {
            "position_m": circle.position_m(again),
            "map_q_base": circle.quaternion(again),
            "reset_count": int(by_counter),
        }

    feed(fusion, "ekf", 20, 14, source_record)
    fused = fused_at(fusion, 12.0)
    # What is lost is the motion of one or two records, at the velocity that was not reported.
    assert fused.pose.position_m == pytest.approx(circle.position_m(12.0), abs=0.15)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(12.0), abs=0.03)
    assert fused.segment > fused_at(fusion, 7.0).segment


def test_implausible_speed_and_turn_rate_are_refused(circle: Circle) -> None:
    fusion = Fusion(OdometryFusionConfig(limits=LimitsConfig(max_speed=2.0, max_turn_rate=90.0)))
    feed(fusion, "ekf", 10, 1, lambda t: {"position_m": circle.position_m(t)})
    fast = record(position_m=circle.position_m(1.1), velocity_map_mps=np.array([3.0, 0, 0]))
    refused = fusion.take("ekf", fast, T0 + round(1.1 * S))
    assert refused == Reject("too_fast", "3.0 m/s; at most 2")
    spinning = record(map_q_base=circle.quaternion(0), rate_radps=np.array([0, 0, 2.0]))
    refused = fusion.take("ahrs", spinning, T0)
    assert refused == Reject("turns_too_fast", "115 deg/s; at most 90")


@pytest.mark.parametrize(("limit_dps", "reported"), [(20.0, False), (90.0, True)])
def test_a_turn_by_attitudes_that_no_vehicle_has_is_invalid(
    limit_dps: float, *, reported: bool
) -> None:
    fusion = Fusion(OdometryFusionConfig(limits=LimitsConfig(max_turn_rate=limit_dps)))

    def turning(t_s: float) -> dict[str, np.ndarray]:
        return {"position_m": np.zeros(3), "map_q_base": rotation_from_rpy(0, 0, 30.0 * t_s)}

    feed(fusion, "ekf", 20, 2, turning)
    rate = fused_at(fusion, 1.0).rate_radps
    assert (rate is None) != reported
    assert rate is None or rate == pytest.approx(np.radians([0, 0, 30.0]), abs=1e-6)


def test_a_jump_of_the_attitude_alone_begins_a_segment(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ekf", 20, 10, lambda t: {"position_m": circle.position_m(t)})

    def turned(t_s: float) -> dict[str, np.ndarray]:
        return {"map_q_base": rotation_from_rpy(0, 0, 0.0 if t_s < 5.0 else 80.0)}

    feed(fusion, "ahrs", 20, 10, turned)
    assert fused_at(fusion, 9.0).segment > fused_at(fusion, 3.0).segment


def test_stamps_of_two_clocks_of_one_sender_are_fitted_apart(circle: Circle) -> None:
    fusion = Fusion()
    for k in range(200):
        t_s, now_ns = k / 20, T0 + k * S // 20
        unset = Odometry(now_ns - 3600 * S, "unix", map_q_base=circle.quaternion(t_s))
        booted = Odometry(5 * S + k * S // 20, "boot", position_m=circle.position_m(t_s))
        fusion.take("fc", unset, now_ns)
        fusion.take("fc", booted, now_ns)
    fused = fused_at(fusion, 8.0)
    assert fused.pose.position_m == pytest.approx(circle.position_m(8.0), abs=0.01)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(8.0), abs=0.01)


@pytest.mark.parametrize("nothing", [0.0, -1.0])
def test_a_covariance_that_is_silent_is_replaced_by_ours(circle: Circle, nothing: float) -> None:
    fusion = Fusion()
    reported = nothing * np.eye(6)
    feed(fusion, "ekf", 20, 2, lambda t: {**circle.pose(t), "pose_covariance": reported})
    assert (np.diag(fused_at(fusion, 1.0).covariance) > 0.0).all()


def test_geographic_positions_have_their_origin_and_the_depth_its_height(circle: Circle) -> None:
    origin = OdometryFusionConfig(origin=GeoOriginConfig(60.0, 5.0))
    fusion = Fusion(origin)
    feed(fusion, "ahrs", 10, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "bar30", 10, 1, lambda _: {"depth_m": 4.0})
    # One second of latitude at 60° north is 30.95 m, one of longitude 15.50 m (WGS-84).
    second = np.radians(1 / 3600)
    place = GeoPoint(np.radians(60.0) + second, np.radians(5.0) + second, None)
    feed(fusion, "usbl", 10, 1, lambda _: {"geo": place})
    fused = fused_at(fusion, 0.5)
    assert fused.pose.position_m == pytest.approx([15.50, 30.95, -4.0], abs=0.01)


def test_a_silent_source_costs_its_pings_and_nothing_else(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ekf", 20, 2, circle.pose)
    feed(fusion, "ekf", 20, 15, circle.pose, start_s=12.0)
    assert [reason_at(fusion, t) for t in (2.2, 7.0, 11.8)] == ["odometry_gap"] * 3
    assert fused_at(fusion, 13.0).pose.position_m == pytest.approx(
        circle.position_m(13.0), abs=1e-3
    )


def test_ready_waits_for_what_encloses_the_moment(circle: Circle) -> None:
    fusion = Fusion()
    assert not fusion.ready(T0)
    feed(fusion, "ahrs", 10, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "ekf", 10, 0.8, lambda t: {"position_m": circle.position_m(t)})
    assert fusion.ready(T0 + round(0.8 * S))
    assert not fusion.ready(T0 + round(0.85 * S))
    feed(fusion, "dvl", 10, 1, lambda _: {"velocity_mps": np.zeros(3)})
    assert not fusion.ready(T0 + round(0.95 * S))  # a position may still come
    feed(fusion, "ahrs", 10, 3, lambda t: {"map_q_base": circle.quaternion(t)}, start_s=1.1)
    feed(fusion, "dvl", 10, 3, lambda _: {"velocity_mps": np.zeros(3)}, start_s=1.1)
    assert fusion.ready(T0 + round(2.0 * S))  # none came for longer than a gap


def test_a_compass_and_a_world_of_arbitrary_heading_are_not_mixed(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 10, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    drifting = record(position_m=np.zeros(3), north_referenced=False)
    refused = fusion.take("dvl", drifting, T0 + 2 * S)
    assert isinstance(refused, Reject)
    assert refused.reason == "mixed_headings"
    alone = Fusion()
    both = record(position_m=np.zeros(3), map_q_base=circle.quaternion(0), north_referenced=False)
    assert alone.take("dvl", both, T0) is None


ATTITUDE_AND_DEPTH = OdometryFusionConfig(
    sources=(OdometrySourceConfig(name="autopilot", format="mavlink"),),
    owners=OwnersConfig(position="fixed"),
)


def test_attitude_alone_lacks_a_position_and_a_fixed_one_replaces_it(circle: Circle) -> None:
    for settings in (OdometryFusionConfig(), ATTITUDE_AND_DEPTH):
        fusion = Fusion(settings)
        feed(fusion, "autopilot", 50, 2, lambda t: {"map_q_base": circle.quaternion(t)})
        feed(fusion, "autopilot", 10, 2, lambda t: {"depth_m": 3.0 + t})
        if settings is ATTITUDE_AND_DEPTH:
            assert fusion.ready(T0 + round(1.03 * S))
            fused = fused_at(fusion, 1.03)
            assert fused.pose.position_m == pytest.approx([0.0, 0.0, -4.03], abs=1e-6)
            assert yaw_of(fused) == pytest.approx(circle.yaw_rad(1.03), abs=1e-6)
            assert fused.velocity_mps == pytest.approx([0.0, 0.0, 0.0])
        else:
            assert reason_at(fusion, 1.03) == "no_position"


def test_a_fixed_position_ignores_positions_and_velocities(circle: Circle) -> None:
    fusion = Fusion(ATTITUDE_AND_DEPTH)
    feed(fusion, "autopilot", 50, 2, lambda t: {"map_q_base": circle.quaternion(t)})
    moved = fusion.take("autopilot", record(position_m=np.ones(3)), T0 + 3 * S)
    assert moved == Reject("other_source", ANY)
    assert fused_at(fusion, 1.03).pose.position_m.tolist() == [0.0, 0.0, 0.0]


def test_a_fixed_position_contradicts_a_source_of_velocity() -> None:
    sources = (OdometrySourceConfig(name="dvl"),)
    with pytest.raises(ValueError, match=r"fixed contradicts owners\.velocity 'dvl'"):
        OdometryFusionConfig(sources, OwnersConfig(position="fixed", velocity="dvl"))
    with pytest.raises(ValueError, match="cannot be called 'fixed'"):
        OdometryFusionConfig((OdometrySourceConfig(name="fixed"),))
    with pytest.raises(ValueError, match=r"owners\.depth 'fixed' is no source"):
        OdometryFusionConfig(sources, OwnersConfig(depth="fixed"))
