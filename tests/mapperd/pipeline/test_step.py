import inspect
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import (
    Config,
    LocalizationConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
)
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import PingImage
from mapperd.imaging.robots import Robot
from mapperd.mapping.sonar_map import PingStats, SonarMap
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline import step
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.executor import TOO_SLOW, PingExecutor
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import fixed_pose
from mapperd.pipeline.step import PingResult, Stages, process_ping, skip_ping
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
FORWARD = MountingConfig(orientation=OrientationConfig(pitch=0.0))
COARSE = Config(octree=OctreeConfig(voxel_resolution=0.2), mounting=FORWARD)
HERE = pose_from_rpy((0, 0, 0), (0, 0, 0))


def step_at(ping: Ping, pose: Pose, sonar_map: SonarMap) -> PingResult:
    """Put a ping of a sonar at rest through the step."""
    return process_ping(PosedPing(0, ping, fixed_pose(pose), None), Stages(sonar_map))


def test_the_step_fits_on_one_screen() -> None:
    source, _ = inspect.getsourcelines(step.process_ping)
    assert len(source) <= 30


def test_ping_changes_the_map_where_the_sonar_looks(ping: MakePing) -> None:
    sonar_map = SonarMap(COARSE)
    result = step_at(ping(9), HERE, sonar_map)
    assert isinstance(result.stats, PingStats)
    assert result.posed.ping.ping_id == 9
    assert result.stats.occupied > 0
    assert result.stats.free > 0
    occupied = sonar_map.voxels("occupied")
    ranges = np.linalg.norm(occupied.centres_m - [0, 0, -0.5], axis=1)
    assert np.abs(ranges - 3.1).max() < 0.3
    assert occupied.centres_m[:, 0].min() > 0


def test_sonar_is_where_pose_and_mounting_put_it(ping: MakePing) -> None:
    sonar_map = SonarMap(COARSE)
    step_at(ping(), pose_from_rpy((100, 50, -10), (0, 0, 90)), sonar_map)
    centres = sonar_map.voxels("occupied").centres_m
    assert np.linalg.norm(centres - [100, 50, -10.5], axis=1) == pytest.approx(3.1, abs=0.3)
    assert centres[:, 1].min() > 50  # yaw 90 degrees: it looks north


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"bearings_cdeg": np.zeros(65, dtype=np.int16)}, "bad_bearings"),
        ({"range_resolution_m": 19.0}, "fan_too_large"),
    ],
)
def test_ping_that_cannot_be_mapped_leaves_the_map_alone(
    ping: MakePing, changes: dict[str, object], reason: str
) -> None:
    sonar_map = SonarMap(COARSE)
    before = sonar_map.sha256()
    result = step_at(ping(**changes), HERE, sonar_map)
    assert result.reject is not None
    assert result.reject.reason == reason
    assert sonar_map.sha256() == before


def test_pose_beyond_the_reach_of_the_map_is_refused(ping: MakePing) -> None:
    fine = msgspec.structs.replace(COARSE, octree=OctreeConfig(voxel_resolution=0.001))
    result = step_at(
        ping(range_resolution_m=0.001), pose_from_rpy((3e7, 0, 0), (0, 0, 0)), SonarMap(fine)
    )
    assert result.reject is not None
    assert result.reject.reason == "refused_by_map"


def test_lever_arm_and_turned_mounting_are_of_the_base(ping: MakePing) -> None:
    mounting = MountingConfig(
        position=PositionConfig(x=2.0, y=1.0, z=-0.5), orientation=OrientationConfig(pitch=90)
    )
    sonar_map = SonarMap(msgspec.structs.replace(COARSE, mounting=mounting))
    step_at(ping(), pose_from_rpy((100, 50, -10), (0, 0, 90)), sonar_map)
    centres = sonar_map.voxels("occupied").centres_m
    # Yaw 90: forward is north, port is west. So 2 m north and 1 m west, looking straight down.
    sonar = np.array([99.0, 52.0, -10.5])
    assert np.linalg.norm(centres - sonar, axis=1) == pytest.approx(3.1, abs=0.3)
    target = np.array([99.0, 52.0, -13.6])
    assert np.linalg.norm(centres - target, axis=1).min() < 0.2
    # The 120 degrees of the fan lie across the base, east to west; along it is the aperture.
    assert np.abs(centres[:, 0] - 99).max() == pytest.approx(3.1 * np.sin(np.pi / 3), abs=0.3)
    assert np.abs(centres[:, 1] - 52).max() < 3.2 * np.sin(np.radians(10)) + 0.2


class _Localization:
    """Keeps the images that it is given, and corrects nothing."""

    def __init__(self) -> None:
        self.images: list[PingImage | Reject] = []

    def correct(
        self, image: PingImage | Reject, pose: FusedPose, _: int | None
    ) -> FusedPose | Reject:
        self.images.append(image)
        return pose


def test_localization_and_the_map_share_one_filtered_image(
    ping: MakePing, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[PingImage] = []

    def counted(image: PingImage, config: Config) -> tuple[PingImage, tuple[Robot, ...]]:
        made.append(image)
        return filter_ping_image(image, config)

    monkeypatch.setattr(step, "filter_ping_image", counted)
    localization = _Localization()
    stages = Stages(SonarMap(COARSE), localization)  # type: ignore[arg-type]
    result = process_ping(PosedPing(0, ping(), fixed_pose(HERE), None), stages)
    assert len(made) == 1
    assert localization.images == [result.image]
    no_pose = PosedPing(1, ping(), Reject("odometry_gap", "none"), None)
    assert process_ping(no_pose, stages).reject is no_pose.pose
    skip_ping(no_pose, stages, COARSE)
    assert len(made) == 1
    skip_ping(PosedPing(2, ping(), fixed_pose(HERE), None), stages, COARSE)
    assert len(localization.images) == 2
    unlike = ping(bearings_cdeg=np.zeros(65, dtype=np.int16))
    refused = process_ping(PosedPing(3, unlike, fixed_pose(HERE), None), stages)
    assert localization.images[2] is refused.reject is not None


@pytest.mark.parametrize(
    ("mapping", "localizes", "has_pose"),
    [
        ("odometry", True, True),
        ("corrected", True, False),
        ("off", True, False),
        ("corrected", False, True),
    ],
)
def test_a_dropped_ping_has_a_pose_only_where_that_of_the_odometry_is_in_the_map(
    ping: MakePing, mapping: Any, *, localizes: bool, has_pose: bool
) -> None:
    config = msgspec.structs.replace(COARSE, localization=LocalizationConfig(mapping=mapping))
    sonar_map = SonarMap(config)
    stages = Stages(sonar_map, _Localization() if localizes else None)  # type: ignore[arg-type]
    executor = PingExecutor(stages, MemoryPersistence(sonar_map))
    results: list[PingResult] = []
    executor.on_ping = results.append
    posed = PosedPing(0, ping(), fixed_pose(HERE), None)
    executor.drop(posed)
    assert results[0].reject is TOO_SLOW
    assert results[0].pose is (posed.pose if has_pose else TOO_SLOW)
