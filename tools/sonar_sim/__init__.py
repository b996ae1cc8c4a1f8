"""A multibeam imaging sonar in a known scene: echoes, pings and captures, on the CPU.

Frames: map x east, y north, z up; base x forward, y port, z up; sonar x along the centre beam,
y to port, z up. Bearings are positive to starboard.
"""

from oculus_driver import __version__
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectPlan, EffectWarning
from sonar_sim.geometry.pose import FramePose, Mounting, SonarMotion
from sonar_sim.geometry.trajectory import Drift, Motion, ObjectMotion, Tour, Trajectory, Waypoint
from sonar_sim.scene.material import MATERIALS, Material
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import (
    Bubbles,
    CloudSpec,
    Emitter,
    PointTarget,
    Scene,
    Sea,
    Sediment,
    Surface,
)
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.scene.vehicle import OdometryErrors, OdometrySample, SimulatedOdometry, Vehicle
from sonar_sim.scene.water import Water
from sonar_sim.scene_file import load_scenario, scene_names
from sonar_sim.simulator import SimulatedPing, Simulator, simulate

__all__ = [
    "MATERIALS",
    "Bubbles",
    "CaptureSettings",
    "CloudSpec",
    "Drift",
    "EffectPlan",
    "EffectWarning",
    "Emitter",
    "FramePose",
    "Material",
    "Motion",
    "Mounting",
    "ObjectMotion",
    "OdometryErrors",
    "OdometrySample",
    "PointTarget",
    "Scenario",
    "Scene",
    "Sea",
    "Sediment",
    "SimulatedOdometry",
    "SimulatedPing",
    "Simulator",
    "SonarMotion",
    "SonarSettings",
    "Surface",
    "Tolerance",
    "Tour",
    "Trajectory",
    "Vehicle",
    "Water",
    "Waypoint",
    "__version__",
    "load_scenario",
    "scene_names",
    "simulate",
    "sonar_preset",
    "write_capture",
]
