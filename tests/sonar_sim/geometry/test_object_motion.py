import math

import numpy as np
import pytest
from sonar_sim.geometry.trajectory import Drift, Motion, Tour, Trajectory, Waypoint


def test_drift_goes_on_steadily_and_swings_about_it() -> None:
    drift = Drift(
        position_m=(1.0, 0.0, -5.0),
        velocity_mps=(0.5, 0.0, 0.0),
        yaw_rate_dps=10.0,
        swing_m=(0.0, 0.2, 0.0),
        swing_deg=(30.0, 0.0, 0.0),
        period_s=4.0,
    )
    assert drift.pose(0.0).position_m == pytest.approx([1.0, 0.0, -5.0])
    assert drift.pose(1.0).position_m == pytest.approx([1.5, 0.2, -5.0])
    assert drift.pose(3.0).position_m == pytest.approx([2.5, -0.2, -5.0])
    # A quarter of the period on: 30 degrees of roll, 10 degrees of yaw.
    rotation = drift.pose(1.0).rotation
    assert math.degrees(math.atan2(rotation[2, 1], rotation[2, 2])) == pytest.approx(30.0)
    assert math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) == pytest.approx(10.0)


def test_tour_starts_again() -> None:
    calm = Motion(sway_deg=0.0, heave_m=0.0)
    path = Trajectory([Waypoint(0, 0, -5, 0), Waypoint(6, 0, -5, 0)], calm)
    tour = Tour(path)
    assert np.array_equal(tour.pose(1.0).position_m, path.pose(1.0).position_m)
    again = tour.pose(path.duration_s + 1.0).position_m
    assert again == pytest.approx(path.pose(1.0).position_m, abs=1e-9)
