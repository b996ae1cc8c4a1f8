import math

import numpy as np
import pytest

from mapperd.geometry.frames import rotation_from_rpy
from mapperd.localization.scan import beam_directions, fan_points, level_T_base, yaw_of


@pytest.mark.parametrize("rpy", [(0, 0, 0), (10, -20, 170), (-30, 40, -90), (0, 80, 33)])
def test_level_frame_keeps_the_heading_only(rpy: tuple[float, float, float]) -> None:
    quaternion = rotation_from_rpy(*rpy)
    assert yaw_of(quaternion) == pytest.approx(math.radians(rpy[2]))
    expected = level_T_base(rotation_from_rpy(rpy[0], rpy[1], 0))
    assert level_T_base(quaternion) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("pitch", [-90.0, 90.0])
def test_on_nose_or_tail_there_is_a_level_frame_all_the_same(pitch: float) -> None:
    transform = level_T_base(rotation_from_rpy(0, pitch, 30))
    assert transform[:3, :3] @ transform[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)


def test_starboard_is_to_the_right_and_elevation_up() -> None:
    (direction,) = beam_directions(np.array([math.radians(30)]), math.radians(45))
    assert direction[1] < 0 < direction[2]
    assert np.linalg.norm(direction) == pytest.approx(1)


def test_horizontal_range_is_the_slant_range_times_the_cosine_of_the_tilt() -> None:
    level_T_sonar = level_T_base(rotation_from_rpy(0, 30, 0))  # noqa: N806 frames are named
    level_T_sonar[:3, 3] = (0.2, 0.0, -0.5)
    (point,) = fan_points(np.array([10.0]), np.array([0.0]), level_T_sonar)
    assert point == pytest.approx([0.2 + 10 * math.cos(math.radians(30)), 0, -0.5 - 5])


def test_roll_moves_starboard_beams_down() -> None:
    level_T_sonar = level_T_base(rotation_from_rpy(10, 0, 0))  # noqa: N806
    port, starboard = fan_points(np.ones(2), np.radians([-60, 60]), level_T_sonar)
    assert starboard[2] == pytest.approx(-math.sin(math.radians(60)) * math.sin(math.radians(10)))
    assert port[2] == pytest.approx(-starboard[2])
