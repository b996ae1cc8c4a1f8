"""Bent rays see as sharply as straight ones: a profile of one speed changes nothing."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Cloud, SoundSpeedProfile
from sonar_sim.propagation.refraction import eigenrays
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.water import Water
from sonar_sim.validation.setups import (
    CHALK,
    MEAN,
    MIRROR,
    cell_power,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    sphere,
    target,
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


GRADIENT = 8.0
"""1/s, of a strong thermocline: speeds rise with the depth."""
SLOPE = SoundSpeedProfile(np.array([-50.0, 50.0]), 1500.0 + GRADIENT * np.array([-50.0, 50.0]))


def arc(from_m: NDArray[np.float64], to_m: NDArray[np.float64]) -> tuple[float, float]:
    """Elevation of departure and travel time of the circle between two points.

    In a constant gradient g paths are circles whose centres lie where the speed would be zero, and
    cosh(g t) = 1 + g² d² / (2 c c') (Officer 1958).
    """
    flat = float(np.hypot(*(to_m - from_m)[:2]))
    rise = float(to_m[2] - from_m[2])
    near, far = (1500.0 - GRADIENT * float(p[2]) for p in (from_m, to_m))
    time_s = math.acosh(1.0 + GRADIENT**2 * (flat**2 + rise**2) / (2.0 * near * far)) / GRADIENT
    # The centre lies c / g above the start, and as far off as makes both radii equal.
    high = near / GRADIENT
    centre = (flat**2 + rise**2 - 2.0 * rise * high) / (2.0 * flat)
    return -math.atan2(centre, high), time_s


@pytest.mark.parametrize("seed", range(12))
def test_path_to_a_point_is_the_circle_of_a_constant_gradient(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = np.array([0.0, 0.0, -rng.uniform(1.0, 20.0)])
    away = rng.uniform(2.0, 60.0) * np.array([math.cos(seed), math.sin(seed), 0.0])
    end = start + away + [0.0, 0.0, rng.uniform(-0.5, 0.5) * np.linalg.norm(away)]
    (ray,) = eigenrays(SLOPE, start, end, 1500.0)
    elevation, time_s = arc(start, end)
    assert math.asin(ray.direction[2]) == pytest.approx(elevation, abs=3e-4)
    assert ray.range_m == pytest.approx(1500.0 * time_s, rel=2e-5)
    assert ray.corner_m[0] == pytest.approx(start)
    assert ray.corner_m[-1] == pytest.approx(end, abs=1e-3)
    assert np.cross(ray.direction, away)[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("depth_m", "speed_mps"),
    [((0.0, 50.0), (1500.0, 1500.0)), ((0.0, 5.0, 10.0, 20.0), (1500.0, 1500.0, 1480.0, 1478.0))],
)
def test_no_point_is_lost_where_sound_goes_straight(
    depth_m: tuple[float, ...], speed_mps: tuple[float, ...]
) -> None:
    layers = SoundSpeedProfile(np.array(depth_m), np.array(speed_mps))
    rng = np.random.default_rng(5)
    for _ in range(40):
        start = np.array([0.0, 0.0, -rng.uniform(0.5, 18.0)])
        end = np.array([rng.uniform(2.0, 12.0), rng.uniform(-5.0, 5.0), -rng.uniform(0.5, 18.0)])
        rays = eigenrays(layers, start, end, 1500.0)
        assert len(rays) == 1
        assert rays[0].corner_m[-1] == pytest.approx(end, abs=1e-3)


def test_straight_up_and_down_paths_are_straight() -> None:
    start = np.array([1.0, 2.0, -3.0])
    for rise in (-10.0, 2.5):
        (ray,) = eigenrays(SLOPE, start, start + np.array([0.0, 0.0, rise]), 1500.0)
        assert ray.direction == pytest.approx([0.0, 0.0, np.sign(rise)], abs=1e-6)
        speeds = 1500.0 - GRADIENT * np.array([-3.0, -3.0 + rise])
        time_s = math.log(speeds.max() / speeds.min()) / GRADIENT
        assert ray.range_m == pytest.approx(1500.0 * time_s, rel=1e-5)


@pytest.mark.parametrize("elevations", [64, 200])
def test_a_floor_in_a_thermocline_has_no_gaps(elevations: int) -> None:
    """Rays that the water spreads still cover it: no row is dark."""
    layers = SoundSpeedProfile(np.array([0.0, 3.5, 4.5]), np.array([1512.0, 1512.0, 1500.0]))
    sonar = narrow_sonar(11.0, 0.04)
    engine = PingEngine(Scene((floor(-4.0, CHALK),)), sonar, elevations=elevations)
    pose = pose_at((0.0, 0.0, -2.0))
    power = cell_power(engine, pose, dataclasses.replace(MEAN, layers=layers)).sum(axis=1)
    beyond = sonar.row_centres_m > 4.0
    # Of straight paths the level would be even; the water below bends these a little steeper.
    level_db = 10.0 * np.log10(power[beyond] * sonar.row_centres_m[beyond] ** 5)
    assert np.abs(np.diff(level_db)).max() < 1.0
    assert np.ptp(level_db) < 2.0


def test_point_targets_stand_where_small_balls_do() -> None:
    """A dull ball and a point at its middle, through the whole engine, on bent paths."""
    sonar = dataclasses.replace(
        narrow_sonar(42.0, 0.02, 256), vertical_width_rad=math.radians(20.0)
    )
    pose = pose_at((0.0, 0.0, -5.0))
    middle, radius_m = (40.0, 1.0, -6.0), 0.1
    water = Water(profile=((0.0, 1500.0),))
    physics = dataclasses.replace(
        MEAN, layers=SLOPE, vertical_width_rad=sonar.vertical_width_rad, sea_surface=False
    )
    ball = Scene((sphere(middle, radius_m, CHALK),), water=water)
    point = Scene(targets=(target(middle),), water=water)
    seen = []
    for scene in (ball, point):
        # So fine a column that the ball is sampled evenly.
        power = np.square(PingEngine(scene, sonar, elevations=1024).ping(pose, physics).amplitude)
        seen.append((np.average(sonar.row_centres_m, weights=power.sum(axis=1)), power))
    near_m = 2.0 / 3.0 * radius_m
    assert seen[1][0] - seen[0][0] == pytest.approx(near_m, abs=0.03)
    assert seen[0][1].sum(axis=0).argmax() == seen[1][1].sum(axis=0).argmax()
    straight = PingEngine(point, sonar).ping(pose, dataclasses.replace(physics, layers=None))
    gain_db = 10.0 * np.log10(seen[1][1].sum() / np.square(straight.amplitude).sum())
    elevation, time_s = arc(pose.position_m, np.array(middle))
    # Spreading goes by the travel time, as that of surfaces.
    spread_db = 40.0 * math.log10(math.dist(middle, pose.position_m) / (1500.0 * time_s))
    pattern = vertical_two_way_power(
        np.sin([elevation, math.asin(-1.0 / math.dist(middle, pose.position_m))]),
        sonar.vertical_width_rad,
    )
    pattern_db = 10.0 * np.log10(pattern[0] / pattern[1])
    assert gain_db == pytest.approx(pattern_db + spread_db, abs=0.1)


def test_a_wall_hides_a_target_only_if_it_cuts_the_bent_path() -> None:
    """Sound bends towards the slow water above, so the path hangs below the chord."""
    sonar = narrow_sonar(42.0, 0.02)
    point = (target((40.0, 0.0, -5.0)),)
    sag_m = 40.0**2 * GRADIENT / (8.0 * 1540.0)
    physics = dataclasses.replace(MEAN, layers=SLOPE)
    for low_m, high_m, hides in (
        (-5.0 - 0.8 * sag_m, 0.0, False),
        (-8.0, -5.0 - 0.8 * sag_m, True),
    ):
        middle_m, tall_m = 0.5 * (low_m + high_m), high_m - low_m
        wall = rectangle((20.0, 0.0, middle_m), (0.0, 4.0, 0.0), (0.0, 0.0, tall_m))
        engine = PingEngine(Scene((wall,), point, water=WATER), sonar)
        seen = engine.ping(pose_at((0.0, 0.0, -5.0)), physics).amplitude
        assert (seen[int(35.0 / sonar.range_resolution_m) :].max() == 0.0) == hides
