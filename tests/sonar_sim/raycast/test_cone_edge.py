"""Where the fan of directions ends: beside the sonar, where its array's cones close."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.raycast.fan import (
    ALL_ELEVATIONS_RAD,
    USUAL_ELEVATIONS_RAD,
    ray_fan,
    solid_angle_sr,
)
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.setups import MEAN, cell_power, floor, pose_at, rectangle

HEIGHT_M = 2.0
SONAR = SonarSettings(beams=192, demanded_range_m=5.0, forced_rows=200)
SEEDS = range(6)


def floor_power() -> NDArray[np.float64]:
    """Of each cell, (rows, beams).

    On the circle where a range meets the floor, whose radius over the range is a, a direction of
    sine s = a sin(turn) stands for R dR dturn of floor: mu cos² i R dR dturn / R⁴ of power.
    """
    fine = 8
    range_m = (np.arange(SONAR.rows * fine) + 0.5) * SONAR.range_resolution_m / fine
    circle = np.sqrt(np.maximum(1.0 - (HEIGHT_M / range_m) ** 2, 0.0))[:, None]
    edges = (np.arange(SONAR.beams + 1) - SONAR.beams / 2.0) * SONAR.sine_pitch
    turn = np.diff(np.arcsin(np.clip(edges / np.maximum(circle, 1e-12), -1.0, 1.0)), axis=1)
    step_m = SONAR.range_resolution_m / fine
    weight = floor().material.mu * HEIGHT_M**2 * step_m / range_m**5
    power: NDArray[np.float64] = np.where(circle > 0.0, turn, 0.0) * weight[:, None]
    cells: NDArray[np.float64] = power.reshape(SONAR.rows, fine, SONAR.beams).sum(axis=1)
    return cells


def at_the_edge(power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the outermost three beams that hold floor, by ranges of ten rows, (bands,)."""
    bands = []
    for first in range(130, 180, 10):
        rows = slice(first, first + 10)
        last = np.flatnonzero(floor_power()[rows].sum(axis=0))[-3:]
        bands.append(power[rows][:, last].sum())
    return np.array(bands)


def test_the_mean_power_at_the_edge_is_the_floor_s_own() -> None:
    power = cell_power(PingEngine(Scene((floor(),)), SONAR), pose_at((0.0, 0.0, HEIGHT_M)), MEAN)
    assert at_the_edge(power) == pytest.approx(at_the_edge(floor_power()), rel=0.1)
    rows = slice(130, 180)
    assert power[rows].sum() == pytest.approx(floor_power()[rows].sum(), rel=0.01)


def test_the_field_s_power_at_the_edge_is_the_floor_s_own() -> None:
    physics = replace(MEAN, speckle=True)
    pose, scene = pose_at((0.0, 0.0, HEIGHT_M)), Scene((floor(),))
    powers = [cell_power(PingEngine(scene, SONAR, seed=seed), pose, physics) for seed in SEEDS]
    got, expected = at_the_edge(np.mean(powers, axis=0)), at_the_edge(floor_power())
    assert got.sum() == pytest.approx(expected.sum(), rel=0.1)


def test_the_floor_under_a_level_sonar_is_heard_from_its_nearest_point_on() -> None:
    """Straight below no row is missing: mean powers by the integral, and fields about them."""
    physics, pose = replace(MEAN, elevations_rad=ALL_ELEVATIONS_RAD), pose_at((0.0, 0.0, HEIGHT_M))
    expected = floor_power().sum(axis=1)
    power = cell_power(PingEngine(Scene((floor(),)), SONAR), pose, physics).sum(axis=1)
    foot = round(HEIGHT_M / SONAR.range_resolution_m)
    assert power[:foot].sum() < 1e-3 * power[foot]
    assert power[foot:180] == pytest.approx(expected[foot:180], rel=0.02)
    speckled = replace(physics, speckle=True)
    fields = [
        cell_power(PingEngine(Scene((floor(),)), SONAR, seed=seed), pose, speckled).sum(axis=1)
        for seed in SEEDS
    ]
    rows = slice(foot, foot + 8)
    assert np.mean(fields, axis=0)[rows].sum() == pytest.approx(expected[rows].sum(), rel=0.1)


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_what_is_straight_above_or_below_is_heard_by_the_pattern_s_far_lobe(up: float) -> None:
    plate = rectangle((0.3, 0.0, up * 1.5), (0.6, 0.0, 0.0), (0.0, 0.4, 0.0))
    engine, pose = PingEngine(Scene((plate,)), SONAR), pose_at((0.0, 0.0, 0.0))
    plain = replace(MEAN, elevations_rad=ALL_ELEVATIONS_RAD)
    heard = replace(plain, vertical_width_rad=SONAR.vertical_width_rad)
    powers = [cell_power(engine, pose, physics).sum() for physics in (MEAN, plain, heard)]
    x, y = np.meshgrid((np.arange(60) + 0.5) / 100.0, (np.arange(40) - 19.5) / 100.0)
    range_m = np.sqrt(x**2 + y**2 + 1.5**2)
    echo = plate.material.mu * (1.5 / range_m) ** 2 * 1e-4 / range_m**4
    pattern = vertical_two_way_power(1.5 / range_m, SONAR.vertical_width_rad)
    assert powers[0] == 0.0
    assert powers[1] == pytest.approx(echo.sum(), rel=0.05)
    assert powers[2] == pytest.approx((echo * pattern).sum(), rel=0.05)
    below_db = 10.0 * np.log10(vertical_two_way_power(np.ones(1), SONAR.vertical_width_rad)[0])
    assert below_db == pytest.approx(-36.4, abs=0.2)


@pytest.mark.parametrize("limits_rad", [USUAL_ELEVATIONS_RAD, ALL_ELEVATIONS_RAD])
def test_the_fan_covers_all_directions_ahead(limits_rad: tuple[float, float]) -> None:
    sonar = replace(SONAR, half_aperture_rad=math.radians(85.0), beams=180)
    fan = ray_fan(sonar, limits_rad=limits_rad)
    top, left = float(fan.cell[:, 3].max()), float(fan.cell[:, 0].min())
    up = (np.arange(100_000) + 0.5) / 100_000 * 2.0 * top - top
    most = np.sqrt(1.0 - up**2)
    assert top == pytest.approx(math.sin(limits_rad[1]))
    expected = np.mean(2.0 * np.arcsin(np.minimum(-left / most, 1.0))) * 2.0 * top
    assert fan.solid_angle_sr.sum() == pytest.approx(expected, rel=1e-3)


def test_a_cell_ends_with_the_directions() -> None:
    one = (np.array([value]) for value in (0.0, 2.0, -1.0, 1.0))
    assert solid_angle_sr(*one)[0] == pytest.approx(math.pi)
