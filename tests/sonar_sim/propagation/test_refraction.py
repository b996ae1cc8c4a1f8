"""Bent rays see as sharply as straight ones: a profile of one speed changes nothing."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.physics import Cloud, SoundSpeedProfile
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.water import Water
from sonar_sim.validation.setups import (
    MEAN,
    MIRROR,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    sphere,
)

LAYERS = SoundSpeedProfile(np.array([0.0, 10.0]), np.array([1500.0, 1500.0]))
WATER = Water(profile=((0.0, 1500.0),))
LATH = rectangle((3.0, 0.1, 0.31), (0.0, 0.6, 0.0), (0.0, 0.0, 0.03))
BALL = sphere((4.0, -0.3, 0.2), 0.05, MIRROR)
CLOUD = Cloud(np.array([1.0, -5.0, -5.0]), np.array([2.0, 5.0, 5.0]), 3.0, -40.0)


def straight_and_bent(
    *surfaces: Surface, clouds: tuple[Cloud, ...] = ()
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    engine = PingEngine(Scene(surfaces, water=WATER), narrow_sonar(6.0, 0.02))
    physics = dataclasses.replace(MEAN, clouds=clouds)
    pose = pose_at((0.0, 0.0, 0.0))
    bent = engine.ping(pose, dataclasses.replace(physics, layers=LAYERS)).amplitude
    return engine.ping(pose, physics).amplitude, bent


@pytest.mark.parametrize("thin", [LATH, BALL], ids=["lath", "ball"])
def test_narrow_things_are_traced_as_finely(thin: Surface) -> None:
    straight, bent = straight_and_bent(thin, floor(-2.0))
    assert straight.max() > 0.0
    assert np.allclose(bent, straight, rtol=0.02, atol=0.01 * float(straight.max()))


def test_clouds_take_their_part_of_bent_paths() -> None:
    wall = rectangle((4.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))
    straight, bent = straight_and_bent(wall, clouds=(CLOUD,))
    assert np.allclose(bent, straight, rtol=0.02, atol=0.01 * float(straight.max()))


def test_a_sonar_that_lies_in_a_face_sees_past_it_on_bent_paths_too() -> None:
    wall = rectangle((4.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))
    mount = rectangle((0.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))
    straight, bent = straight_and_bent(wall, mount)
    assert straight.max() > 0.0
    assert np.allclose(bent, straight, rtol=0.02, atol=0.01 * float(straight.max()))
