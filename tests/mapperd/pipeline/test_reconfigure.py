"""Settings change between two pings, through every layer down to the map."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore, Refused
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, missing_extra
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.imaging.filter_chain import check_filters
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.decoder import PosedPing, SessionDecoder
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.pose_lookup import FixedPose, fixed_pose
from mapperd.pipeline.step import PingResult, Stages, process_ping
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
HERE = pose_from_rpy((0, 0, 0), (0, 0, 0))
ROWS, BEAMS = 50, 65


def step_at(ping: Ping, pose: Pose, sonar_map: SonarMap) -> PingResult:
    """Put a ping of a sonar at rest through the step."""
    return process_ping(PosedPing(0, ping, fixed_pose(pose), None), Stages(sonar_map))


def config_with(**sections: Any) -> Config:
    coarse: dict[str, Any] = {
        "octree": {"voxel_resolution": 0.2},
        "mounting": {"orientation": {"pitch": 0}},
    }
    return msgspec.convert(coarse | sections, Config)


def stepping_with(config: Config) -> tuple[PingExecutor, ConfigStore, SonarMap, SessionDecoder]:
    sonar_map = SonarMap(config)
    pipeline = build_pipeline(sonar_map, FixedPose(HERE), remarks=None)
    stepping, engine = pipeline.executor, pipeline.decoder
    store = ConfigStore(Layered(config))
    store.follow(PingExecutor.FOLLOWS, stepping.reconfigure, check_filters)
    store.follow(PingExecutor.FOLLOWS, engine.reconfigure)
    return stepping, store, sonar_map, engine


def step_on(stepping: PingExecutor, engine: SessionDecoder, *pings: Ping) -> None:
    for ping in pings:
        engine.offer(ping, None, None)
    for posed in engine.end():
        assert isinstance(posed, PosedPing)
        stepping.map_ping(posed)


@pytest.mark.parametrize(
    "changes",
    [
        {"filtering.intensity_threshold": 20},
        {"filtering.intensity_threshold": 199},
        {"filtering.min_range": 2.5},
        {"mounting.orientation.pitch": 30, "mounting.orientation.yaw": -20},
        {"mapping.integrator": "rays"},
        {"mapping.detail": 4, "mapping.aggregation": "mean"},
        {"mapping.carve_no_return": True},
        {"crosstalk.enabled": True, "crosstalk.morpho_kernel_size": 3},
        {"robot_detection.enabled": True, "robot_detection.keep_out": True},
    ],
    ids=str,
)
def test_changed_map_goes_on_as_one_that_always_had_the_settings(
    ping: MakePing, changes: dict[str, Any]
) -> None:
    wall = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    wall[30:32, : 40 if "mapping.carve_no_return" in changes else BEAMS] = 200
    stepping, store, sonar_map, engine = stepping_with(config_with())
    step_on(stepping, engine, ping(1))
    sonar_map.core.clear()
    assert isinstance(store.apply(changes, "test"), Applied)
    pings = [ping(k, image=wall) for k in (2, 3)]
    step_on(stepping, engine, *pings)
    assert sonar_map.config == store.current
    always, before = SonarMap(store.current), SonarMap(config_with())
    for one in pings:
        step_at(one, HERE, always)
        step_at(one, HERE, before)
    assert sonar_map.sha256() == always.sha256() != before.sha256()


def test_change_waits_for_the_next_ping(ping: MakePing) -> None:
    stepping, store, sonar_map, engine = stepping_with(config_with())
    store.apply({"filtering.intensity_threshold": 210}, "test")
    assert sonar_map.config.filtering.intensity_threshold == 35
    step_on(stepping, engine, ping(1))
    assert sonar_map.config.filtering.intensity_threshold == 210
    assert len(sonar_map.voxels("occupied")) == 0


def test_frames_are_skipped_from_the_next_ping_on(ping: MakePing) -> None:
    stepping, store, _, engine = stepping_with(config_with())
    step_on(stepping, engine, ping(1), ping(2))
    store.apply({"processing.frame_skip": 3}, "test")
    step_on(stepping, engine, *(ping(k) for k in range(3, 9)))
    assert stepping.counters.pings_mapped == 4
    assert stepping.counters.pings_dropped == {"frame_skip": 4}


def test_map_refuses_another_grid_or_rule() -> None:
    sonar_map = SonarMap(config_with())
    for section, value in (
        ("octree", {"voxel_resolution": 0.1}),
        ("iwlo", {"L_occ": 1}),
        ("adaptive", {"max_ratio": 0.5}),
    ):
        with pytest.raises(ConfigError, match=rf"\$\.{section}: cannot change"):
            sonar_map.reconfigure(config_with(**{section: value}))
    assert sonar_map.config == config_with()


def test_filter_without_its_library_is_refused_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    _, store, _, _ = stepping_with(config_with())
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    for name in ("crosstalk.enabled", "robot_detection.enabled"):
        result = store.apply({name: True}, "test")
        assert isinstance(result, Refused)
        assert missing_extra("OpenCV", "filters") in result.reasons[name]
    with pytest.raises(ConfigError, match="OpenCV cannot be imported"):
        stepping_with(config_with(crosstalk={"enabled": True}))
    assert store.current == config_with()


def bright_spot() -> np.ndarray:
    """A robot before a wall: (rows, beams)."""
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    image[40:42] = 120
    image[20:23, 30:35] = 220
    return image


def test_robots_are_reported_and_kept_out_of_the_map(ping: MakePing) -> None:
    seen = ping(1, image=bright_spot())
    kept_out = SonarMap(config_with(robot_detection={"enabled": True, "keep_out": True}))
    result = step_at(seen, HERE, kept_out)
    assert result.reject is None
    ((robot, place_m),) = result.robots
    assert (robot.samples, robot.peak) == (15, 220)
    assert place_m == pytest.approx((2.15, 0, -0.5), abs=0.05)
    ranges = np.linalg.norm(kept_out.voxels("occupied").centres_m - [0, 0, -0.5], axis=1)
    assert ranges.min() > 3.5

    in_it = SonarMap(config_with(robot_detection={"enabled": True}))
    step_at(seen, HERE, in_it)
    ranges = np.linalg.norm(in_it.voxels("occupied").centres_m - [0, 0, -0.5], axis=1)
    assert ranges.min() < 2.5


def test_sightings_are_remembered_until_they_expire(ping: MakePing) -> None:
    config = config_with(robot_detection={"enabled": True})
    stepping, _, _, engine = stepping_with(config)
    step_on(stepping, engine, ping(1, arrival_ns=10**9, image=bright_spot()))
    (sighting,) = stepping.sightings.since(5 * 10**9, config.robot_detection.expire_sec)
    assert sighting.t_ns == 10**9
    assert stepping.sightings.since(12 * 10**9, config.robot_detection.expire_sec) == []


def test_stripe_does_not_reach_the_map(ping: MakePing) -> None:
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    image[40:42, 20:30] = 120
    rope = image.copy()
    image[33] = 180
    maps = [SonarMap(config_with(crosstalk={"enabled": on})) for on in (True, False, True)]
    for sonar_map, picture in zip(maps, (image, image, rope), strict=True):
        step_at(ping(1, image=picture), HERE, sonar_map)
    clean, dirty, never = (sonar_map.sha256() for sonar_map in maps)
    assert clean == never != dirty
