"""Motion within the ping, from the vehicle's velocity and rate to where the voxels lie."""

import math
from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.tree import (
    Config,
    MappingConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
    SonarConfig,
)
from mapperd.errors import MapError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.motion import BaseMotion, PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import fixed_pose
from mapperd.pipeline.step import Stages, process_ping
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
FORWARD = Config(
    sonar=SonarConfig(
        vertical_aperture=20.0
    ),  # so many voxels that their middle is known to 0.02 m
    octree=OctreeConfig(voxel_resolution=0.05),
    mounting=MountingConfig(
        position=PositionConfig(z=0.0), orientation=OrientationConfig(pitch=0.0)
    ),
)
ROWS, BEAMS, RANGE_M = 150, 33, 30.0


def wall_echo(row: int) -> PingImage:
    """One bright row in a fan of 20 degrees."""
    intensity = np.zeros((ROWS, BEAMS), dtype=np.float32)
    intensity[row] = 200.0
    bearings = np.arcsin(math.sin(math.radians(10)) * np.linspace(-1, 1, BEAMS))
    return PingImage(intensity, bearings, RANGE_M / ROWS)


def middle(sonar_map: SonarMap) -> NDArray[np.float64]:
    return np.asarray(sonar_map.voxels("occupied").centres_m.mean(axis=0))


def shift_by(motion: PingMotion, mapping: MappingConfig) -> NDArray[np.float64]:
    """How far a wall at 27 m comes to lie from where a sonar at rest puts it."""
    middles = []
    for reported in (None, motion):
        config = msgspec.structs.replace(FORWARD, mapping=mapping, octree=OctreeConfig(0.1))
        sonar_map = SonarMap(config)
        sonar_map.integrate(wall_echo(134), np.eye(4), reported)
        middles.append(middle(sonar_map))
    return middles[1] - middles[0]


def motion(linear: tuple[float, ...], angular: tuple[float, ...], valid_s: float) -> PingMotion:
    return PingMotion(np.array(linear), np.array(angular), valid_s, 1500.0)


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
@pytest.mark.parametrize(
    ("moving", "expected_m"),
    [
        # 27 m: 18 ms out, 36 ms there and back.
        (motion((5, 0, 0), (0, 0, 0), 0.0), (0.09, 0, 0)),
        (motion((0, 5, 0), (0, 0, 0), 0.0), (0, 0.18, 0)),
        (motion((0, 0, 5), (0, 0, 0), 0.018), (0, 0, 0.09)),
        (motion((0, 0, 0), (0, 0, 0.5), 0.0), (0, 27 * 0.018, 0)),
        (motion((0, 0, 0), (0, 0.5, 0), 0.018), (0, 0, -27 * 0.009)),
    ],
)
def test_samples_lie_where_the_sonar_was(
    moving: PingMotion, expected_m: tuple[float, ...], integrator: str
) -> None:
    shift = shift_by(moving, MappingConfig(integrator=integrator))  # type: ignore[arg-type]
    assert shift == pytest.approx(expected_m, abs=0.02)


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_the_setting_leaves_motion_out(integrator: str) -> None:
    mapping = MappingConfig(integrator=integrator, within_ping_motion=False)  # type: ignore[arg-type]
    shift = shift_by(motion((5, 5, 5), (0.5, 0.5, 0.5), 0.0), mapping)
    assert shift.tolist() == [0, 0, 0]


def test_a_turning_base_swings_the_sonar_on_its_lever_arm() -> None:
    # Looking down, 2 m ahead and 1 m below; the base heads north and turns to port.
    mounting = MountingConfig(
        position=PositionConfig(x=2.0, z=-1.0), orientation=OrientationConfig(pitch=90)
    )
    base_T_sonar = SonarMap(Config(mounting=mounting)).base_T_sonar  # noqa: N806
    moving = BaseMotion(velocity_map_mps=(0.0, 1.0, 0.0), rate_radps=(0.0, 0.0, 0.5))
    pose = pose_from_rpy((100, 50, -10), (0, 0, 90))
    found = moving.of_sonar(pose, base_T_sonar, 0.01, 1480.0)
    assert found.linear_mps == pytest.approx((-1.0, 1.0, 0.0))  # port of north is west
    # Up is what lies behind the sonar's back.
    assert found.angular_radps == pytest.approx((-0.5, 0.0, 0.0))
    assert (found.valid_s, found.speed_of_sound_mps) == (0.01, 1480.0)


def test_what_is_unknown_is_taken_as_at_rest() -> None:
    found = BaseMotion().of_sonar(pose_from_rpy((0, 0, 0), (0, 0, 0)), np.eye(4), 0.0, 1500.0)
    assert found.linear_mps.tolist() == found.angular_radps.tolist() == [0, 0, 0]


def test_the_step_holds_the_pose_at_the_middle_of_the_image(ping: MakePing) -> None:
    far = {"range_resolution_m": 0.6, "speed_of_sound_mps": 1450.0}  # 30 m; the wall at 18.6 m
    coarse = msgspec.structs.replace(FORWARD, octree=OctreeConfig(0.2))
    here = pose_from_rpy((0, 0, 0), (0, 0, 0))
    middles = []
    for rate in (None, (0.0, 0.0, 1.0)):
        sonar_map = SonarMap(coarse)
        posed = replace(fixed_pose(here), rate_radps=None if rate is None else np.array(rate))
        process_ping(PosedPing(0, ping(**far), posed, None), Stages(sonar_map))
        centres = sonar_map.voxels("occupied").centres_m
        middles.append(np.arctan2(centres[:, 1], centres[:, 0]).mean())
    # Received 2 * 18.6 m after transmission, the pose holds at 15 m of sound's way.
    expected = (2 * 18.6 - 15.0) / 1450.0
    assert middles[1] - middles[0] == pytest.approx(expected, abs=0.1 * expected)


def test_a_speed_of_sound_that_cannot_be_is_not_taken(ping: MakePing) -> None:
    sonar_map = SonarMap(msgspec.structs.replace(FORWARD, octree=OctreeConfig(0.2)))
    here = pose_from_rpy((0, 0, 0), (0, 0, 0))
    moving = replace(fixed_pose(here), velocity_mps=np.array([1.0, 0.0, 0.0]))
    posed = PosedPing(0, ping(speed_of_sound_mps=0.0), moving, None)
    assert process_ping(posed, Stages(sonar_map)).reject is None


@pytest.mark.parametrize(
    "moving",
    [
        motion((math.nan, 0, 0), (0, 0, 0), 0.0),
        motion((0, 0, 31), (0, 0, 0), 0.0),
        motion((0, 0, 0), (0, 26, 0), 0.0),
        motion((0, 0, 0), (0, 0, 1), math.inf),
        PingMotion(np.zeros(3), np.ones(3), 0.0, 0.0),
        PingMotion(np.zeros(2), np.ones(3), 0.0, 1500.0),
    ],
)
@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_motion_that_cannot_be_is_refused(moving: PingMotion, integrator: str) -> None:
    mapping = MappingConfig(integrator=integrator)  # type: ignore[arg-type]
    sonar_map = SonarMap(msgspec.structs.replace(FORWARD, mapping=mapping))
    with pytest.raises(MapError):
        sonar_map.integrate(wall_echo(100), np.eye(4), moving)
    assert sonar_map.counts().free == 0
