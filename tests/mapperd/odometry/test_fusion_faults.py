"""What goes wrong between sources: noise, silence, returns, times set back, others' claims."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from mapperd.config.odometry import (
    GeoOriginConfig,
    OdometryFusionConfig,
    OdometrySourceConfig,
    OwnersConfig,
    SlamQualityConfig,
    TimeSyncConfig,
    WorldInitConfig,
)
from mapperd.errors import Reject
from mapperd.odometry.fusion import FusedPose, Fusion
from mapperd.odometry.records import GeoPoint, Odometry
from tests.mapperd.odometry.conftest import T0, Circle, S, feed, fused_at, record, yaw_of


def at_s(t_s: float) -> int:
    return T0 + round(t_s * S)


def reason_at(fusion: Fusion, t_s: float) -> str:
    reject = fusion.at(at_s(t_s))
    assert isinstance(reject, Reject), reject
    return reject.reason


def test_motion_is_not_reported_by_the_noise_of_neighbours(circle: Circle) -> None:
    """400 Hz and 1 cm: two neighbours would give 6 m/s, and two attitudes of 0.1° 60°/s."""
    fusion, chance = Fusion(), np.random.default_rng(3)

    def noisy(t: float) -> dict[str, object]:
        half = (circle.yaw_rad(t) + math.radians(0.1) * chance.standard_normal()) / 2
        return {
            "position_m": circle.position_m(t) + 0.01 * chance.standard_normal(3),
            "map_q_base": np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
        }

    feed(fusion, "ekf", 400, 3, noisy)
    for t_s in np.arange(0.5, 2.9, 0.1):
        fused = fused_at(fusion, t_s)
        assert fused.velocity_mps == pytest.approx(circle.velocity_map_mps(t_s), abs=0.25)
        assert fused.rate_radps == pytest.approx([0, 0, circle.rate_radps], abs=0.05)


def test_motion_of_rare_records_is_that_of_those_around(circle: Circle) -> None:
    fusion = Fusion(time_sync=TimeSyncConfig(max_gap_sec=1.0))
    feed(fusion, "ekf", 2, 3, circle.pose)
    fused = fused_at(fusion, 1.25)
    assert fused.velocity_mps == pytest.approx(circle.velocity_map_mps(1.25), abs=0.01)
    assert fused.rate_radps == pytest.approx([0, 0, circle.rate_radps], abs=1e-6)


def test_motion_that_cannot_be_is_unknown(circle: Circle) -> None:
    """Positions whose noise is large and rare enough to look like a leap of the vehicle."""
    fusion = Fusion()
    feed(fusion, "ahrs", 10, 1, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "ekf", 10, 1, lambda t: {"position_m": np.array([0.4 * round(10 * t % 2), 0, 0])})
    feed(
        fusion, "ekf", 10, 1.3, lambda t: {"position_m": np.array([8 * (t - 1), 0, 0])}, start_s=1.1
    )
    feed(fusion, "ahrs", 10, 1.3, lambda t: {"map_q_base": circle.quaternion(t)}, start_s=1.1)
    assert fused_at(fusion, 1.2).velocity_mps is None


@pytest.mark.parametrize("owners", [OwnersConfig(), OwnersConfig(depth="bar30")])
def test_a_silent_depth_is_no_height_of_zero(circle: Circle, owners: OwnersConfig) -> None:
    """Places on Earth have no height: without the depth they would lie at the surface."""
    settings = OdometryFusionConfig(
        sources=tuple(OdometrySourceConfig(name=name) for name in ("gps", "ahrs", "bar30")),
        owners=owners,
        origin=GeoOriginConfig(60.0, 5.0),
    )
    fusion = Fusion(settings)
    place = GeoPoint(math.radians(60.0), math.radians(5.0), None)
    feed(fusion, "ahrs", 10, 5, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "gps", 10, 5, lambda _: {"geo": place})
    feed(fusion, "bar30", 5, 2, lambda _: {"depth_m": 7.0})
    assert fused_at(fusion, 1.5).pose.position_m[2] == pytest.approx(-7.0)
    assert reason_at(fusion, 3.0) == "no_depth"


def test_a_ping_waits_for_the_depth_that_encloses_it(circle: Circle) -> None:
    settings = OdometryFusionConfig(
        sources=(OdometrySourceConfig(name="ekf"), OdometrySourceConfig(name="bar30")),
        owners=OwnersConfig(depth="bar30"),
    )
    fusion = Fusion(settings)
    feed(fusion, "ekf", 50, 2, circle.pose)
    assert not fusion.ready(at_s(1.15))  # none ever came
    feed(fusion, "bar30", 5, 1, lambda t: {"depth_m": t})
    assert not fusion.ready(at_s(1.15))
    assert fusion.ready(at_s(1.9))  # silent for longer than a gap
    feed(fusion, "bar30", 5, 1.2, lambda t: {"depth_m": t}, start_s=1.2)
    assert fusion.ready(at_s(1.15))
    assert fused_at(fusion, 1.15).pose.position_m[2] == pytest.approx(-1.15)


def test_depth_is_not_tilted_by_levelling() -> None:
    """An odometry that leans by 10° about y, driving ahead in it: pressure gives 3 m throughout."""
    half = math.radians(-10.0) / 2
    leaning = np.array([math.cos(half), 0.0, math.sin(half), 0.0])  # base as its world has it
    settings = OdometryFusionConfig(
        sources=(OdometrySourceConfig(name="slam"), OdometrySourceConfig(name="bar30")),
        owners=OwnersConfig(depth="bar30"),
    )
    fusion = Fusion(settings, world_init=WorldInitConfig(enabled=True, init_samples=5))
    up = np.array([0.0, 0.0, 9.81])
    ahead = np.array([math.cos(2 * half), 0.0, -math.sin(2 * half)])
    feed(
        fusion,
        "slam",
        10,
        2,
        lambda t: {
            "position_m": ahead * t,
            "map_q_base": leaning,
            "specific_force_mps2": up,
        },
    )
    feed(fusion, "bar30", 10, 2, lambda _: {"depth_m": 3.0})
    assert fused_at(fusion, 1.5).pose.position_m == pytest.approx([1.5, 0.0, -3.0], abs=1e-9)


def test_levelling_hears_the_owner_of_the_attitude_alone(circle: Circle) -> None:
    fusion = Fusion(world_init=WorldInitConfig(enabled=True, init_samples=3))
    feed(fusion, "ekf", 10, 0.2, circle.pose)
    force = {"specific_force_mps2": np.array([9.81, 0.0, 0.0])}
    feed(fusion, "other", 10, 2, lambda t: {**circle.pose(t), **force})
    assert fusion.status()["levelling"] is not None


@pytest.mark.parametrize(("at_jump", "off_m"), [("continue", 0.0), ("follow", 2.0)])
def test_a_position_that_returns_elsewhere_opens_a_segment(
    circle: Circle, at_jump: str, off_m: float
) -> None:
    """30 s of dead reckoning, then the position comes back, 2 m from where that has come to."""
    fusion = Fusion(msgspec.structs.replace(OdometryFusionConfig(), at_jump=at_jump))
    gone = np.array([2.0, 0.0, 0.0])
    feed(fusion, "ahrs", 20, 40, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 40, lambda _: {"velocity_mps": np.array([circle.speed_mps, 0, 0])})
    feed(fusion, "ekf", 10, 2, lambda t: {"position_m": circle.position_m(t)})
    reckoned = fused_at(fusion, 31.0)
    feed(fusion, "ekf", 10, 40, lambda t: {"position_m": circle.position_m(t) + gone}, start_s=32)
    after = fused_at(fusion, 35.0)
    assert reckoned.segment == fused_at(fusion, 1.0).segment
    assert after.segment == reckoned.segment + 1
    off = after.pose.position_m - circle.position_m(35.0)
    assert off == pytest.approx([off_m, 0, 0], abs=0.02)


def test_a_position_that_returns_where_it_was_expected_opens_none(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 20, 40, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 40, lambda _: {"velocity_mps": np.array([circle.speed_mps, 0, 0])})
    feed(fusion, "ekf", 10, 2, lambda t: {"position_m": circle.position_m(t)})
    feed(fusion, "ekf", 10, 40, lambda t: {"position_m": circle.position_m(t)}, start_s=32)
    assert len({fused_at(fusion, t).segment for t in (1.0, 20.0, 35.0)}) == 1


def test_segments_never_count_down(circle: Circle) -> None:
    fusion = Fusion()
    body = {"velocity_mps": np.array([circle.speed_mps, 0, 0])}
    feed(fusion, "ahrs", 20, 20, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 2, lambda _: body)
    feed(fusion, "ekf", 10, 6, lambda t: {"position_m": circle.position_m(t)})
    feed(fusion, "dvl", 10, 20, lambda _: body, start_s=4)  # lost its lock in between
    feed(fusion, "ekf", 10, 20, lambda t: {"position_m": circle.position_m(t)}, start_s=12)
    segments = [fused_at(fusion, t).segment for t in np.arange(0.5, 20, 0.5)]
    assert segments == sorted(segments)


def test_a_stray_first_record_does_not_move_the_map(circle: Circle) -> None:
    fusion = Fusion()
    far = {"position_m": np.array([50.0, 0, 0]), "map_q_base": np.array([0.0, 0.0, 0.0, 1.0])}
    fusion.take("ekf", record(**far), T0)
    feed(fusion, "ekf", 10, 3, circle.pose, start_s=0.1)
    fused = fused_at(fusion, 2.0)
    assert fused.pose.position_m == pytest.approx(circle.position_m(2.0), abs=2e-3)
    assert yaw_of(fused) == pytest.approx(circle.yaw_rad(2.0), abs=1e-6)


def test_a_report_without_a_velocity_does_not_own_velocities(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "ahrs", 20, 5, lambda t: {"map_q_base": circle.quaternion(t)})
    fusion.take("ekf", record(valid=False), T0)
    feed(fusion, "dvl", 10, 5, lambda _: {"velocity_mps": np.array([1.0, 0, 0])})
    assert fusion.status()["quantities"]["velocity"]["owner"] == "dvl"


def test_another_sources_doubt_does_not_stop_the_map(circle: Circle) -> None:
    """A DVL far from the bottom is not sure; the position comes from elsewhere, and is."""
    fusion = Fusion(quality=SlamQualityConfig(fail_mode="closed"))
    feed(fusion, "ekf", 10, 3, lambda t: {**circle.pose(t), "confidence": 0.9})
    body = {"velocity_mps": np.array([1.0, 0, 0]), "confidence": 0.0}
    feed(fusion, "dvl", 10, 3, lambda _: body)
    assert isinstance(fusion.at(at_s(2.0)), FusedPose)
    feed(fusion, "ekf", 10, 4, lambda t: {**circle.pose(t), "confidence": 0.1}, start_s=3.1)
    assert reason_at(fusion, 3.5) == "low_confidence"


def test_a_clock_that_is_set_back_costs_some_records_and_no_more(circle: Circle) -> None:
    fusion = Fusion()
    body = {"velocity_mps": np.array([circle.speed_mps, 0, 0])}
    feed(fusion, "ekf", 10, 20, lambda t: {**circle.pose(t), **body}, start_s=10)
    feed(fusion, "ekf", 10, 5, lambda t: {**circle.pose(t), **body})
    fused = fused_at(fusion, 3.0)
    assert fused.pose.position_m == pytest.approx(circle.position_m(3.0), abs=2e-3)
    assert fused.segment > 0
    rejected = fusion.status()["quantities"]["position"]["rejected"]
    assert rejected == {"back_in_time": 9}


def test_late_records_do_not_look_like_a_clock_set_back(circle: Circle) -> None:
    """Every second record is 2 s late, as over a radio: none of them restarts anything."""
    fusion = Fusion()
    for k in range(100):
        t_s = 0.1 * k - 2.0 * (k % 2)
        fusion.take("ekf", record(**circle.pose(t_s)), at_s(t_s))
    assert fusion.status()["quantities"]["position"]["rejected"] == {"back_in_time": 50}
    assert fused_at(fusion, 5.0).segment == 0


@pytest.mark.parametrize("policy", ["latest", "nearest", "interpolate"])
def test_covariances_are_finite_whatever_is_known(circle: Circle, policy: str) -> None:
    sync = msgspec.structs.replace(TimeSyncConfig(), policy=policy)
    fusion = Fusion(time_sync=sync)
    unknown = np.full((6, 6), 0.0)
    np.fill_diagonal(unknown, [1e6, 0.01, 0.01, 0.02, 1e6, 0.02])
    feed(fusion, "ekf", 10, 2, lambda t: {**circle.pose(t), "pose_covariance": unknown})
    covariance = fused_at(fusion, 1.95).covariance
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_a_sender_whose_clock_is_ahead_is_not_believed(circle: Circle) -> None:
    """Its stamps come from the future by 0.2 s: the arrivals give its clock offset."""
    fusion = Fusion()
    for k in range(200):
        t_ns = at_s(0.02 * k)
        reported = Odometry(stamp_ns=t_ns + S // 5, clock="unix", **circle.pose(0.02 * k))
        fusion.take("ekf", reported, t_ns + 3_000_000)
    fused = fused_at(fusion, 3.0)
    # The 3 ms of the link itself are what no fit can see.
    assert fused.pose.position_m == pytest.approx(circle.position_m(3.0 - 0.003), abs=1e-3)


def test_a_quantity_can_be_left_out(circle: Circle) -> None:
    """A DVL's own dead reckoning has a heading of its own: only its velocity is of use."""
    settings = OdometryFusionConfig(
        sources=(OdometrySourceConfig(name="dvl"), OdometrySourceConfig(name="ahrs")),
        owners=OwnersConfig(position="none", attitude="ahrs", velocity="dvl"),
    )
    fusion = Fusion(settings)
    own = record(position_m=np.array([7.0, 0, 0]), north_referenced=False)
    assert isinstance(fusion.take("dvl", own, T0), Reject)
    feed(fusion, "ahrs", 20, 5, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 5, lambda _: {"velocity_mps": np.array([circle.speed_mps, 0, 0])})
    found = fused_at(fusion, 4.0).pose.position_m
    assert found[:2] == pytest.approx(circle.position_m(4.0)[:2], abs=2e-3)


def test_a_world_of_its_own_heading_does_not_keep_the_named_attitude_out(circle: Circle) -> None:
    """Whichever comes first: the attitude has a name, the position has none."""
    settings = OdometryFusionConfig(
        sources=(OdometrySourceConfig(name="dvl"), OdometrySourceConfig(name="ahrs")),
        owners=OwnersConfig(attitude="ahrs"),
    )
    fusion = Fusion(settings)
    refused = fusion.take("dvl", record(position_m=np.zeros(3), north_referenced=False), T0)
    assert isinstance(refused, Reject)
    assert refused.reason == "mixed_headings"
    assert fusion.take("ahrs", record(map_q_base=circle.quaternion(0)), T0) is None


def test_dead_reckoning_outlives_a_clock_that_is_set_back(circle: Circle) -> None:
    fusion = Fusion()
    body = {"velocity_mps": np.array([circle.speed_mps, 0, 0])}
    feed(fusion, "ahrs", 10, 20, lambda t: {"map_q_base": circle.quaternion(t), **body}, start_s=10)
    feed(fusion, "ahrs", 10, 5, lambda t: {"map_q_base": circle.quaternion(t), **body})
    displacement_m = fused_at(fusion, 4.0).pose.position_m - fused_at(fusion, 2.0).pose.position_m
    assert displacement_m == pytest.approx(
        circle.position_m(4.0) - circle.position_m(2.0), abs=5e-3
    )


def test_a_jump_turns_the_world_of_its_source_and_no_others(circle: Circle) -> None:
    """The estimate restarts, facing its own x; the velocity comes from geographic fixes."""
    fusion = Fusion()
    feed(fusion, "gps", 10, 14, lambda t: {"velocity_map_mps": circle.velocity_map_mps(t)})
    feed(fusion, "ekf", 20, 8, circle.pose)
    feed(fusion, "ekf", 20, 14, lambda t: {**circle.pose(t - 8), "reset_count": 1}, start_s=8.05)
    late = Fusion()
    feed(late, "ekf", 20, 8, circle.pose)
    feed(late, "ekf", 20, 14, lambda t: {**circle.pose(t - 8), "reset_count": 1}, start_s=8.05)
    feed(late, "gps", 10, 14, lambda t: {"velocity_map_mps": circle.velocity_map_mps(t)})
    for one in (fusion, late):
        assert one.status()["quantities"]["velocity"]["owner"] == "gps"
        found = fused_at(one, 12.0).velocity_mps
        assert found == pytest.approx(circle.velocity_map_mps(12.0), abs=0.01)


@pytest.mark.parametrize("with_depth", [False, True])
def test_a_position_after_reckoning_from_nowhere_opens_a_segment(
    circle: Circle, *, with_depth: bool
) -> None:
    fusion = Fusion()
    away = np.array([100.0, 0.0, 0.0])
    body = {"velocity_mps": np.array([circle.speed_mps, 0, 0])}
    feed(fusion, "ahrs", 20, 5, lambda t: {"map_q_base": circle.quaternion(t)})
    feed(fusion, "dvl", 10, 2, lambda _: body)
    feed(fusion, "dvl", 10, 5, lambda _: body, start_s=3)  # lost its lock in between
    if with_depth:
        feed(fusion, "bar30", 10, 10, lambda _: {"depth_m": 3.0})
    before = [fused_at(fusion, t) for t in (1.0, 4.0)]
    feed(fusion, "ahrs", 20, 10, lambda t: {"map_q_base": circle.quaternion(t)}, start_s=5.1)
    feed(fusion, "dvl", 10, 10, lambda _: body, start_s=5.1)
    feed(fusion, "ekf", 10, 10, lambda t: {"position_m": circle.position_m(t) + away}, start_s=5.1)
    after = fused_at(fusion, 8.0)
    assert before[0].segment < before[1].segment < after.segment
    assert after.pose.position_m == pytest.approx(circle.position_m(8.0) + away, abs=2e-3)


def test_a_bridge_started_again_under_another_name_takes_over(circle: Circle) -> None:
    fusion = Fusion()
    feed(fusion, "nav", 10, 2, lambda t: circle.pose(t) | {"source": "old"})
    stray = record(**circle.pose(2.1), source="new")
    refused = fusion.take("nav", stray, T0 + round(2.1 * S))
    assert isinstance(refused, Reject)
    assert refused.reason == "other_source"
    feed(fusion, "nav", 10, 8, lambda t: circle.pose(t) | {"source": "new"}, start_s=5.0)
    back = fused_at(fusion, 7.0)
    assert back.segment > fused_at(fusion, 1.0).segment
    assert fusion.status()["quantities"]["position"]["sender"] == "new"


def test_a_clock_set_back_on_the_way_is_noticed(circle: Circle) -> None:
    fusion = Fusion()
    for k in range(200):
        true_ns = T0 + k * S // 20
        clock_ns = true_ns - (300_000_000 if k >= 100 else 0)
        odometry = Odometry(stamp_ns=clock_ns, clock="unix", **circle.pose(k / 20))
        fusion.take("nav", odometry, true_ns + 3_000_000)
    fused = fused_at(fusion, 9.0)
    assert fused.pose.position_m == pytest.approx(circle.position_m(9.0), abs=0.02)
    assert fusion.rejects["nav"]["clock_off"] >= 1


def test_only_the_owner_sets_the_origin_on_earth(circle: Circle) -> None:
    sources = tuple(OdometrySourceConfig(name=name) for name in ("one", "two"))
    fusion = Fusion(
        OdometryFusionConfig(sources=sources, owners=OwnersConfig(position="one", attitude="two"))
    )
    far, here = (GeoPoint(np.radians(d), 0.0, None) for d in (10.0, 60.0))
    fusion.take("two", record(geo=far, map_q_base=circle.quaternion(0)), T0)
    feed(fusion, "one", 10, 1, lambda _: {"geo": here})
    feed(fusion, "two", 10, 1, lambda t: {"map_q_base": circle.quaternion(t)}, start_s=0.1)
    assert fused_at(fusion, 0.5).pose.position_m == pytest.approx([0, 0, 0], abs=1e-6)
