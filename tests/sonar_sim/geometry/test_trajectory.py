import math

import numpy as np
import pytest
from sonar_sim.geometry.pose import Mounting, quaternion_of, rotation_of
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.scene_file import load_scenario

CALM = Motion(speed_mps=0.5, sway_deg=0.0, heave_m=0.0)


def test_straight_leg_is_driven_at_its_speed_with_the_nose_ahead() -> None:
    path = Trajectory([Waypoint(0, 0, -2, 90), Waypoint(0, 10, -2, 90)], CALM)
    assert path.duration_s == pytest.approx(20.0)
    pose = path.pose(10.0)
    assert pose.position_m == pytest.approx([0.0, 5.0, -2.0], abs=1e-6)
    assert pose.rotation[:, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    assert path.velocity_mps(10.0) == pytest.approx([0.5, 0.0, 0.0], abs=1e-6)


def test_turn_on_the_spot_has_its_rate() -> None:
    path = Trajectory([Waypoint(0, 0, 0, 0), Waypoint(0, 0, 0, 180)], CALM)
    rates = path.turn_rates_rps(path.duration_s / 2.0)
    assert rates == pytest.approx([0.0, 0.0, math.radians(CALM.turn_rate_dps)], abs=1e-3)


def test_velocities_are_the_derivatives_of_the_pose() -> None:
    path = load_scenario("harbour").trajectory
    step_s = 1e-3
    for time_s in np.linspace(1.0, path.duration_s - 1.0, 25):
        before, after = path.pose(time_s - step_s), path.pose(time_s + step_s)
        world = (after.position_m - before.position_m) / (2.0 * step_s)
        expected = path.pose(time_s).rotation.T @ world
        assert path.velocity_mps(time_s) == pytest.approx(expected, abs=1e-4)


def test_motion_is_gentle_enough_for_one_pose_a_ping() -> None:
    path = load_scenario("harbour").trajectory
    times_s = np.linspace(0.0, path.duration_s, 500)
    speed = max(float(np.linalg.norm(path.velocity_mps(t))) for t in times_s)
    rate = max(float(np.linalg.norm(path.turn_rates_rps(t))) for t in times_s)
    # Limits of half a row of 8 mm and half a beam at 5.8 m: v R/c and 2 w R/c.
    assert speed * 5.76 / 1490.0 < 0.004
    assert rate * 2.0 * 5.76 / 1490.0 < math.radians(0.5)


@pytest.mark.parametrize("angles_deg", [(0, 0, 0), (170, 5, -60), (0, 90, 0), (12, -80, 179.9)])
def test_quaternion_means_the_same_rotation(angles_deg: tuple[float, float, float]) -> None:
    rotation = rotation_of(*np.radians(angles_deg))
    w, x, y, z = quaternion_of(rotation)
    again = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert again == pytest.approx(rotation, abs=1e-12)


def test_default_mounting_looks_down_with_its_up_forward() -> None:
    rotation = Mounting().pose.rotation
    assert rotation[:, 0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert rotation[:, 2] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
