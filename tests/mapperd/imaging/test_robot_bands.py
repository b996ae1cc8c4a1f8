import math

import numpy as np
import pytest

from mapperd.config.tree import RobotDetectionConfig, TerrainDetectionConfig
from mapperd.imaging.robots import (
    MAX_ROBOTS,
    MAX_SIGHTINGS,
    Robot,
    Sighting,
    Sightings,
    find_robots,
    terrain_of,
)

BEARINGS = np.linspace(-1.0, 1.0, 101)
ROBOTS = RobotDetectionConfig(enabled=True)
KEPT_OUT = RobotDetectionConfig(enabled=True, keep_out=True)
TERRAIN = TerrainDetectionConfig()


def water() -> np.ndarray:
    return np.zeros((100, 101), dtype=np.float32)


def test_bright_group_is_a_robot_where_it_is() -> None:
    image = water()
    image[49:52, 69:72] = 200
    image[50, 70] = 250
    (robot,) = find_robots(image, BEARINGS, 0.1, ROBOTS)
    assert robot.range_m == pytest.approx(5.05)
    assert robot.bearing_rad == pytest.approx(0.4)
    assert (robot.samples, robot.peak) == (9, 250)


def test_centre_leans_to_the_brighter_side() -> None:
    image = water()
    image[50:52, 70:72] = [[180, 180], [240, 240]]
    (robot,) = find_robots(image, BEARINGS, 0.1, ROBOTS)
    assert robot.range_m == pytest.approx((50.5 * 180 + 51.5 * 240) / 420 * 0.1)


def test_threshold_is_the_first_intensity_of_robots() -> None:
    image = water()
    image[10:12, 10:12] = 180
    image[20:22, 20:22] = 179.9
    assert len(find_robots(image, BEARINGS, 0.1, ROBOTS)) == 1


def test_groups_touch_at_corners_and_small_ones_are_invalid() -> None:
    image = water()
    for k in range(4):
        image[10 + k, 10 + k] = 200
    image[50, 50:53] = 200
    (robot,) = find_robots(image, BEARINGS, 0.1, ROBOTS)
    assert robot.range_m == pytest.approx(1.2)
    assert len(find_robots(image, BEARINGS, 0.1, RobotDetectionConfig(min_samples=3))) == 2


def test_largest_come_first_and_no_more_than_the_bound() -> None:
    image = water()
    image[::4, ::4] = 200
    image[2:4, 2:4] = 200
    robots = find_robots(image, BEARINGS, 0.1, RobotDetectionConfig(min_samples=1))
    assert len(robots) == MAX_ROBOTS
    assert robots[0].samples > 1
    assert [robot.samples for robot in robots[1:]] == [1] * (MAX_ROBOTS - 1)


def test_no_robot_in_empty_water() -> None:
    assert find_robots(water(), BEARINGS, 0.1, ROBOTS) == []


def test_map_sees_terrain_and_robots_but_nothing_weak() -> None:
    image = np.tile(np.array([0, 79.9, 80, 179.9, 180, 255], dtype=np.float32), (6, 1))
    seen = terrain_of(image, TERRAIN, ROBOTS)
    assert seen[0].tolist() == [0, 0, *image[0, 2:].tolist()]


def test_robots_stay_out_of_the_map_on_request_but_single_bright_samples_do_not() -> None:
    image = water()
    image[10:12, 10:12] = 200
    image[30, 30] = 200
    image[40, 40] = 100
    seen = terrain_of(image, TERRAIN, KEPT_OUT)
    assert seen[10, 10] == 0
    assert seen[30, 30] == 200
    assert seen[40, 40] == 100
    assert (terrain_of(image, TERRAIN, ROBOTS) == image).all()


def test_gap_between_the_bands_is_neither() -> None:
    image = np.full((10, 101), 170, dtype=np.float32)
    terrain = TerrainDetectionConfig(max_threshold=160)
    assert (terrain_of(image, terrain, ROBOTS) == 0).all()
    assert find_robots(image, BEARINGS, 0.1, ROBOTS) == []


def test_robot_has_a_place_in_the_map() -> None:
    robot = Robot(10.0, math.radians(30), 5, 200.0)
    pose = np.array([[0, -1, 0, 100], [1, 0, 0, 50], [0, 0, 1, -3], [0, 0, 0, 1]])
    # It looks north; starboard is east.
    expected = (100 + 5.0, 50 + 10 * math.cos(math.radians(30)), -3.0)
    assert robot.position_m(pose.astype(np.float64)) == pytest.approx(expected)


def sighting(t_s: float) -> Sighting:
    return Sighting(round(t_s * 1e9), (0.0, 0.0, 0.0), Robot(1.0, 0.0, 4, 200.0))


def test_sightings_expire() -> None:
    sightings = Sightings()
    sightings.add([sighting(0), sighting(5)])
    assert len(sightings.since(round(10e9), 10)) == 2
    assert [one.t_ns for one in sightings.since(round(10e9) + 1, 10)] == [5_000_000_000]
    assert sightings.since(round(16e9), 10) == []
    assert sightings.since(round(5e9), 10) == []  # forgotten is forgotten


def test_clock_set_back_leaves_no_sighting_for_ever() -> None:
    sightings = Sightings()
    sightings.add([sighting(1000)])
    assert sightings.since(0, 10) == []


def test_memory_is_bounded_and_reports_what_it_lost() -> None:
    sightings = Sightings()
    sightings.add(sighting(k * 1e-3) for k in range(MAX_SIGHTINGS + 10))
    assert len(sightings.since(round(4e9), 10)) == MAX_SIGHTINGS
    assert sightings.crowded_out == 10
