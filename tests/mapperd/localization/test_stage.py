"""The localization stage: what is localized, at which pose pings are mapped, what is reported."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config, SonarConfig
from mapperd.errors import ConfigError, MapError, Reject
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.localization.known_map import MAX_SIDE, KnownMap
from mapperd.localization.map_filter import MapFilter
from mapperd.localization.maps import GridMap
from mapperd.localization.models import check_localization
from mapperd.localization.odom_correction import MapFromOdom, placed
from mapperd.localization.session import begun, restored_session, saved_state
from mapperd.localization.stage import LocalizationStage
from mapperd.localization.status import sample_of
from mapperd.odometry.fusion import FusedPose
from mapperd.session_log import InitialPose, NewMap, NoMotionUpdate
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import StreamParser
from tests.mapperd.localization.filter_cases import filter_at
from tests.mapperd.localization.room import Floats, dive, pings, room, settings, write_room

Step = Callable[[LocalizationStage, int], FusedPose | Reject]


def fused(at: Floats, velocity: Floats | None = None) -> FusedPose:
    x, y, yaw = at
    pose = pose_from_rpy((x, y, 0.0), (0.0, 0.0, math.degrees(yaw)))
    return FusedPose(pose, velocity, None, np.zeros((6, 6)), 0, 0.0)


@pytest.fixture(scope="module")
def heard() -> list[PingImage]:
    found = []
    parser = StreamParser()
    for data in pings(room(), dive(30).truth):
        (message,) = parser.feed(data, 0)
        ping = decode_ping(message)
        assert isinstance(ping, Ping)
        found.append(ping_image_of(ping, SonarConfig()))
    return found


@pytest.fixture
def config(tmp_path: Path) -> Config:
    return config_from_text(settings(write_room(tmp_path), mapping="corrected"))


def stage_of(config: Config) -> LocalizationStage:
    localizing = begun(config)
    assert localizing is not None
    return localizing.stage


def driven(
    stage: LocalizationStage, heard: list[PingImage], first: int, last: int
) -> list[FusedPose | Reject]:
    track = dive(30).odometry
    return [stage.correct(heard[k], fused(track[k]), k * 200_000_000) for k in range(first, last)]


def with_amcl(config: Config, **values: object) -> Config:
    return msgspec.structs.replace(config, amcl=msgspec.structs.replace(config.amcl, **values))


def test_pings_are_mapped_where_the_vehicle_is(config: Config, heard: list[PingImage]) -> None:
    where = driven(stage_of(config), heard, 0, 30)[-1]
    assert isinstance(where, FusedPose)
    truth, odometry = dive(30).truth[-1], dive(30).odometry[-1]
    assert math.dist(where.pose.position_m[:2], truth[:2]) < 0.2
    assert math.dist(odometry[:2], truth[:2]) > 0.25
    assert where.covariance[0, 0] > 0


def test_scan_without_an_update_is_mapped_by_the_last_correction(
    config: Config, heard: list[PingImage]
) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 10)
    before = stage.snapshot()
    odom = fused(dive(30).odometry[9] + (0.05, 0.0, 0.0))
    where = stage.correct(heard[9], odom, 2_000_000_000)
    after = stage.snapshot()
    assert after.updates == before.updates
    assert after.counts["still"] == 1
    assert (after.stamp_ns, after.odom_ns) == (before.stamp_ns, 2_000_000_000)
    assert after.particles is before.particles  # resampled only after a change
    assert isinstance(where, FusedPose)
    assert before.pose is not None
    moved = where.pose.position_m - before.pose.position_m
    assert np.hypot(*moved[:2]) == pytest.approx(0.05)


def test_ping_without_an_image_is_counted_by_its_reason(
    config: Config, heard: list[PingImage]
) -> None:
    stage, why = stage_of(config), Reject("bad_bearings", "not a fan")
    driven(stage, heard, 0, 10)
    before = stage.snapshot()
    where = stage.correct(why, fused(dive(30).odometry[9]), 2_000_000_000)
    assert isinstance(where, FusedPose)  # at the last correction
    after = stage.snapshot()
    assert after.counts["bad_bearings"] == 1
    assert after.updates == before.updates


def test_a_jump_of_the_odometry_is_nothing_to_map_by(
    config: Config, heard: list[PingImage]
) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 10)
    far = fused(dive(30).odometry[10] + (50.0, 0.0, 0.0))
    where = stage.correct(heard[10], far, 2_000_000_000)
    assert isinstance(where, Reject)
    assert where.reason == "odometry_jump"


def test_ambiguous_belief_is_nothing_to_map_by(config: Config, heard: list[PingImage]) -> None:
    anywhere = with_amcl(config, set_initial_pose=False)
    ours = msgspec.structs.replace(anywhere.localization, mode="global")
    stage = stage_of(msgspec.structs.replace(anywhere, localization=ours))
    (where,) = driven(stage, heard, 0, 1)
    assert isinstance(where, Reject)
    assert where.reason == "ambiguous"
    snapshot = stage.snapshot()
    assert not snapshot.sure
    assert snapshot.belief is not None
    assert snapshot.belief.ambiguous


def test_other_settings_keep_the_particles(config: Config, heard: list[PingImage]) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 10)
    cloud = stage.snapshot().particles.copy()
    stage.reconfigure(with_amcl(config, laser_sigma_hit=0.3, max_beams=20))
    assert np.array_equal(stage._filter.particles.poses, cloud[:, :3])
    where = driven(stage, heard, 10, 12)[-1]
    assert isinstance(where, FusedPose)


def test_settings_that_the_filter_refuses_change_nothing(
    config: Config, heard: list[PingImage]
) -> None:
    stage = stage_of(config)
    bad = with_amcl(config, laser_z_hit=1e-300, laser_z_rand=0.0)
    with pytest.raises(ConfigError, match=r"\$\.amcl"):
        check_localization(bad)
    stage.reconfigure(bad)
    assert stage.snapshot().counts["settings_refused"] == 1
    assert isinstance(driven(stage, heard, 0, 3)[-1], FusedPose)


def test_facts_of_a_vehicle_that_waits(config: Config, heard: list[PingImage]) -> None:
    stage = stage_of(with_amcl(config, set_initial_pose=False))
    assert stage.request(NoMotionUpdate(1)) is not None
    driven(stage, heard, 0, 2)
    snapshot = stage.snapshot()
    assert snapshot.state == "waiting for a pose"
    assert snapshot.counts == {"no_filter": 2}
    assert (snapshot.belief, snapshot.transform, snapshot.pose, snapshot.stamp_ns) == (None,) * 4
    assert snapshot.particles.shape == (0, 4)
    assert snapshot.diagnosis.level == "OK"


def test_scan_stands_on_the_walls(config: Config, heard: list[PingImage]) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 20)
    points = stage.snapshot().scan_points_m
    assert points is not None
    grid = room()
    walls = grid.centres_m(*np.nonzero(grid.occupancy == 100))
    nearest = [np.hypot(*(walls - one[:2]).T).min() for one in points]
    assert np.median(nearest) < 0.15


def test_maps_are_refused_where_one_was_asked_for(config: Config, tmp_path: Path) -> None:
    stage = stage_of(with_amcl(config, use_map_topic=False))
    refused = stage.request(NewMap(1, str(tmp_path / "other.yaml"), "0"))
    assert refused is not None
    assert refused.reason == "map_topic_off"


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_request_that_is_no_pose_is_refused_and_changes_nothing(
    config: Config, heard: list[PingImage], number: float
) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 10)
    before = stage.snapshot()
    for pose in ((number, 0.0, (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)), (0.0, 0.0, (-1.0,) * 9)):
        refused = stage.request(InitialPose(1, pose[0], pose[1], 0.0, pose[2], "map"))
        assert refused is not None
        assert refused.reason == "bad_request"
    after = stage.snapshot()
    assert after.counts["bad_request"] == 2
    assert after.particles is before.particles
    assert isinstance(driven(stage, heard, 10, 12)[-1], FusedPose)


def test_map_that_cannot_be_had_or_taken_is_refused(config: Config) -> None:
    def gone(path: str, _: str) -> KnownMap:
        raise MapError(f"{path}: gone", "bad_map_file")

    def wide(path: str, sha256: str) -> KnownMap:
        return KnownMap(path, sha256, GridMap(np.zeros((1, MAX_SIDE + 1), np.int8), 0.1))

    for load in (gone, wide):
        stage = LocalizationStage(config, KnownMap("room", "", room()), load=load)
        refused = stage.request(NewMap(1, "other.yaml", "0"))
        assert refused is not None
        assert refused.reason == "bad_request"
        assert stage.snapshot().counts == {"bad_request": 1}
        known = stage.snapshot().known
        assert known is not None
        assert known.path == "room"


def test_new_start_forgets_the_belief(config: Config, heard: list[PingImage]) -> None:
    stage = stage_of(config)
    driven(stage, heard, 0, 5)
    covariance = tuple(np.diag([0.1, 0.1, 0.1]).ravel().tolist())
    assert stage.request(InitialPose(1, 0.0, 0.0, 0.0, covariance, "map")) is None
    snapshot = stage.snapshot()
    assert (snapshot.belief, snapshot.transform, snapshot.sure) == (None, None, False)
    assert abs(snapshot.particles[:, 0].mean()) < 0.1


def test_restored_one_goes_on_to_the_bit(config: Config, heard: list[PingImage]) -> None:
    localizing = begun(config)
    assert localizing is not None
    driven(localizing.stage, heard, 0, 15)
    again = restored_session(config, saved_state(localizing))
    one, other = (driven(stage, heard, 15, 30) for stage in (localizing.stage, again.stage))
    for here, there in zip(one, other, strict=True):
        assert isinstance(here, FusedPose)
        assert isinstance(there, FusedPose)
        assert np.array_equal(here.pose.position_m, there.pose.position_m)
        assert np.array_equal(here.covariance, there.covariance)
    assert dict(localizing.stage.snapshot().counts) == dict(again.stage.snapshot().counts)


@pytest.mark.slow
def test_restored_one_tries_the_same_alternative(config: Config, heard: list[PingImage]) -> None:
    ours = msgspec.structs.replace(
        config.localization, alternative_interval=1.0, tempering=0.2, search_poses=20_000
    )
    product = with_amcl(config, laser_model_type="likelihood_field_prob")
    config = msgspec.structs.replace(product, localization=ours)
    localizing = begun(config)
    assert localizing is not None
    first = localizing.stage
    begin = 0
    while first._filter.alternative is None:
        driven(first, heard, begin, begin + 1)
        begin += 1
    again = restored_session(config, saved_state(localizing)).stage
    for k in range(begin, 30):
        for stage in (first, again):
            driven(stage, heard, k, k + 1)
        here, there = first._filter.alternative, again._filter.alternative
        assert (here is None) == (there is None)
        if here is not None and there is not None:
            assert here.log_odds == there.log_odds
            assert np.array_equal(here.particles.poses, there.particles.poses)
    assert first._filter.alternatives == again._filter.alternatives


def test_all_that_a_filter_knows_is_in_its_state(config: Config) -> None:
    """Each attribute of the filter is in its state, or listed here with the reason why not."""
    given, to_look_at = {"_config", "_map"}, {"weighed", "verdict"}
    held = {
        "_particles",
        "_stamp_ns",
        "watch",
        "alternative",
        "alternatives",
        "confirmed",
        "_blind",
        "_alone_m",
        "_window",
        "_unverified_m",
    }
    assert set(vars(MapFilter(config))) - given - to_look_at == held


def test_pose_and_all_that_belongs_to_it_turn() -> None:
    odom = dataclasses.replace(
        fused(np.array([1.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.5])),
        covariance=np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        rate_radps=np.array([0.1, 0.2, 0.3]),
    )
    estimate = PlanarGaussian(5.0, 8.0, math.pi / 2, np.diag([0.1, 0.2, 0.3]))
    found = placed(odom, MapFromOdom(0, 5.0, 7.0, math.pi / 2), estimate)
    assert found.pose.position_m == pytest.approx([5.0, 8.0, 0.0])
    assert found.velocity_mps == pytest.approx([0.0, 2.0, 0.5])
    assert found.rate_radps == pytest.approx([0.1, 0.2, 0.3])
    assert np.diag(found.covariance) == pytest.approx([0.1, 0.2, 3.0, 5.0, 4.0, 0.3])


def test_sample_stands_for_the_weights() -> None:
    poses = np.column_stack([np.arange(2000.0), np.zeros(2000), np.zeros(2000)])
    weights = np.where(np.arange(2000) < 1000, 3.0, 1.0)
    sample = sample_of(filter_at(poses, weights))
    assert sample.shape == (500, 4)
    assert sample[:, 3].sum() == pytest.approx(1)
    assert (sample[:, 0] < 1000).mean() == pytest.approx(0.75, abs=0.01)
    few = sample_of(filter_at(poses[:20], weights[:20]))
    assert np.array_equal(few[:, :3], poses[:20])
