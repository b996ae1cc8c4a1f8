"""Ends of beams on their cones."""

import dataclasses
import math

import numpy as np
import pytest

from mapperd.localization.scan import Scan, level_T_base
from mapperd.localization.weighting import elevation_fan_rad, ends_on_cones


def scan(bearing_rad: list[float], range_m: float = 10.0) -> Scan:
    count = len(bearing_rad)
    ranges, ones = np.full(count, range_m), np.ones(count)
    bearings = np.array(bearing_rad)
    return Scan(
        0, bearings, ranges, np.zeros((count, 3)), ones, np.arange(count), ones, 20.0, np.eye(4)
    )


def test_elevations_are_the_middles_of_equal_parts() -> None:
    assert elevation_fan_rad(1, 0.4).tolist() == [0.0]
    assert elevation_fan_rad(4, 0.4) == pytest.approx([-0.15, -0.05, 0.05, 0.15])


def test_ends_have_the_range_and_the_component_along_the_array() -> None:
    elevations = np.radians([-10.0, 0.0, 10.0])
    ends = ends_on_cones(scan([-1.0, 0.0, 0.5]), elevations, base_height_m=-3.0)
    assert ends.shape == (3, 3, 3)
    from_sonar = ends - (0, 0, -3)
    assert np.linalg.norm(from_sonar, axis=-1) == pytest.approx(np.full((3, 3), 10.0))
    along = -10.0 * np.sin([-1.0, 0.0, 0.5])
    assert from_sonar[..., 1] == pytest.approx(np.repeat(along[:, None], 3, axis=1))
    assert ends[1, 2] == pytest.approx(
        (10 * math.cos(elevations[2]), 0, -3 + 10 * math.sin(elevations[2]))
    )
    beside_deg = math.degrees(math.atan2(-from_sonar[0, 2, 1], from_sonar[0, 2, 0])) + 57.2958
    assert beside_deg == pytest.approx(-1.4, abs=0.1)


def test_mounting_roll_and_pitch_turn_and_shift_the_ends() -> None:
    level = level_T_base([math.cos(0.1), 0, math.sin(0.1), 0])  # 0.2 rad nose down
    level[:3, 3] = (0.5, 0.1, -0.2)
    tilted = dataclasses.replace(scan([0.0]), level_T_sonar=level)
    end = ends_on_cones(tilted, np.zeros(1), base_height_m=-3.0)[0, 0]
    assert end == pytest.approx((0.5 + 10 * math.cos(0.2), 0.1, -3.2 - 10 * math.sin(0.2)))


def test_beams_along_the_array_have_no_elevation() -> None:
    ends = ends_on_cones(scan([math.pi / 2]), np.radians([-10.0, 10.0]), 0.0)
    assert ends[0] == pytest.approx(np.array([[0, -10, 0]] * 2), abs=1e-6)
