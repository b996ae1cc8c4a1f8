"""A scenario: a scene, a sonar, its vehicle and trajectory; the sonar's pose and motion."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from sonar_sim.geometry.pose import FramePose, Mounting, SonarMotion
from sonar_sim.geometry.trajectory import ObjectMotion, Trajectory
from sonar_sim.scene.scene import Scene, Surface
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
        sonar_name: of the sonar on its vehicle.
        others: further sonars in the same scene, on this vehicle (of the same name and trajectory)
            or on others; they have no others themselves.
    """

    name: str
    scene: Scene
    sonar: SonarSettings
    trajectory: Trajectory
    mounting: Mounting = field(default_factory=Mounting)
    vehicle: Vehicle = field(default_factory=Vehicle)
    ping_rate_hz: float = 5.0
    description: str = ""
    sonar_name: str = "sonar"
    others: tuple["Scenario", ...] = ()

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
    return motion_on(scenario.trajectory, scenario.mounting, time_s)[1]


def motion_on(path: Trajectory, mounting: Mounting, time_s: float) -> tuple[FramePose, SonarMotion]:
    """The pose of a sonar whose vehicle is on a path, and its motion as of `sonar_motion`."""
    base, mounted = path.pose(time_s), mounting.pose
    turn_rps = path.turn_rates_rps(time_s)
    arm_mps = np.cross(turn_rps, mounted.position_m)
    body_mps = path.velocity_mps(time_s) + arm_mps
    motion = SonarMotion(base.rotation @ body_mps, mounted.rotation.T @ turn_rps)
    return base @ mounted, motion


def with_bodies(scene: Scene, vehicles: Iterable[tuple[Vehicle, ObjectMotion]]) -> Scene:
    """The scene with vehicles as boxes that move; those without a size are left out."""
    bodies = tuple(
        _body(vehicle, vehicle.size_m, motion)
        for vehicle, motion in vehicles
        if vehicle.size_m is not None
    )
    return replace(scene, surfaces=scene.surfaces + bodies) if bodies else scene


def _body(vehicle: Vehicle, size_m: tuple[float, float, float], motion: ObjectMotion) -> Surface:
    corners = (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5).astype(np.float64) * size_m
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    name = f"vehicle {vehicle.name}"
    return Surface(name, corners, np.array(faces), vehicle.material, motion=motion)
