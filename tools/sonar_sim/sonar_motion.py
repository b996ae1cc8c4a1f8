"""Pose and motion of a scenario's sonar at a time."""

import numpy as np

from sonar_sim.geometry.pose import Pose, SonarMotion
from sonar_sim.scenario import Scenario


def sonar_pose(scenario: Scenario, time_s: float) -> Pose:
    """The sonar in the map."""
    return scenario.trajectory.pose(time_s) @ scenario.mounting.pose


def sonar_motion(scenario: Scenario, time_s: float) -> SonarMotion:
    """Velocity in the map, lever arm included, and turn rates in the sonar frame."""
    base = scenario.trajectory.pose(time_s)
    mounting = scenario.mounting.pose
    turn_rps = scenario.trajectory.turn_rates_rps(time_s)
    arm_mps = np.cross(turn_rps, mounting.position_m)
    body_mps = scenario.trajectory.velocity_mps(time_s) + arm_mps
    return SonarMotion(base.rotation @ body_mps, mounting.rotation.T @ turn_rps)
