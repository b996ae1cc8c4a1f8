"""A scenario: a scene, a sonar, its vehicle and trajectory; the sonar's pose and motion."""

from dataclasses import dataclass, field

import numpy as np

from sonar_sim.geometry.pose import FramePose, Mounting, SonarMotion
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """All that a survey needs.

    Attributes:
        name: by which it is shipped, or its file's.
        scene: what is there.
        sonar: what looks.
        trajectory: the vehicle's true path.
        mounting: how the sonar sits on the vehicle.
        vehicle: its odometry.
        ping_rate_hz: asked for; the sound's travel may allow less.
        description: one sentence.
    """

    name: str
    scene: Scene
    sonar: SonarSettings
    trajectory: Trajectory
    mounting: Mounting = field(default_factory=Mounting)
    vehicle: Vehicle = field(default_factory=Vehicle)
    ping_rate_hz: float = 5.0
    description: str = ""

    @property
    def true_ping_rate_hz(self) -> float:
        """Pings a second: a ping is over when its last echo is back."""
        speed_mps = self.scene.water.speed_of_sound_mps
        return min(self.ping_rate_hz, speed_mps / (2.0 * self.sonar.range_m))


def sonar_pose(scenario: Scenario, time_s: float) -> FramePose:
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
