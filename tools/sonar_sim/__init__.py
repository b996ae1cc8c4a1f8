"""A multibeam imaging sonar in a known scene: echoes, pings and captures, on the CPU.

Frames: map x east, y north, z up; base x forward, y port, z up; sonar x along the centre beam,
y to port, z up. Bearings are positive to starboard.
"""

from sonar_sim.capture import CaptureSettings, Survey, write_capture
from sonar_sim.harbour import harbour
from sonar_sim.poses import Mounting, Pose
from sonar_sim.scene import Material, Scene, Surface
from sonar_sim.simulator import SimulatedPing, Simulator
from sonar_sim.sonar import SonarSettings
from sonar_sim.survey import harbour_survey
from sonar_sim.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.water import Water

__all__ = [
    "CaptureSettings",
    "Material",
    "Motion",
    "Mounting",
    "Pose",
    "Scene",
    "SimulatedPing",
    "Simulator",
    "SonarSettings",
    "Surface",
    "Survey",
    "Trajectory",
    "Water",
    "Waypoint",
    "harbour",
    "harbour_survey",
    "write_capture",
]
