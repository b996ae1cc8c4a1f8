"""A multibeam imaging sonar in a known scene: echoes, pings and captures, on the CPU.

Frames: map x east, y north, z up; base x forward, y port, z up; sonar x along the centre beam,
y to port, z up. Bearings are positive to starboard.

Everything of `__all__` is imported when first asked for: a missing extra is missed there.
"""

import importlib
from typing import TYPE_CHECKING

from oculus_driver import __version__

if TYPE_CHECKING:
    from sonar_sim.capture import CaptureSettings, write_capture
    from sonar_sim.effects.image_difference import Tolerance
    from sonar_sim.effects.plan import EffectPlan, EffectWarning
    from sonar_sim.geometry.driving import DriveCommand
    from sonar_sim.geometry.live_path import LivePath
    from sonar_sim.geometry.pose import FramePose, Mounting, SonarMotion
    from sonar_sim.geometry.trajectory import (
        Drift,
        Motion,
        ObjectMotion,
        Tour,
        Trajectory,
        Waypoint,
    )
    from sonar_sim.scanning import ScanningSonar
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
    from sonar_sim.world import World, WorldPing

__all__ = [
    "MATERIALS",
    "Bubbles",
    "CaptureSettings",
    "CloudSpec",
    "Drift",
    "DriveCommand",
    "EffectPlan",
    "EffectWarning",
    "Emitter",
    "FramePose",
    "LivePath",
    "Material",
    "Motion",
    "Mounting",
    "ObjectMotion",
    "OdometryErrors",
    "OdometrySample",
    "PointTarget",
    "ScanningSonar",
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
    "World",
    "WorldPing",
    "__version__",
    "load_scenario",
    "scene_names",
    "simulate",
    "sonar_preset",
    "write_capture",
]

_MODULES = {
    "Bubbles": "sonar_sim.scene.scene",
    "CaptureSettings": "sonar_sim.capture",
    "CloudSpec": "sonar_sim.scene.scene",
    "Drift": "sonar_sim.geometry.trajectory",
    "DriveCommand": "sonar_sim.geometry.driving",
    "EffectPlan": "sonar_sim.effects.plan",
    "EffectWarning": "sonar_sim.effects.plan",
    "Emitter": "sonar_sim.scene.scene",
    "FramePose": "sonar_sim.geometry.pose",
    "LivePath": "sonar_sim.geometry.live_path",
    "MATERIALS": "sonar_sim.scene.material",
    "Material": "sonar_sim.scene.material",
    "Motion": "sonar_sim.geometry.trajectory",
    "Mounting": "sonar_sim.geometry.pose",
    "ObjectMotion": "sonar_sim.geometry.trajectory",
    "OdometryErrors": "sonar_sim.scene.vehicle",
    "OdometrySample": "sonar_sim.scene.vehicle",
    "PointTarget": "sonar_sim.scene.scene",
    "ScanningSonar": "sonar_sim.scanning",
    "Scenario": "sonar_sim.scene.scenario",
    "Scene": "sonar_sim.scene.scene",
    "Sea": "sonar_sim.scene.scene",
    "Sediment": "sonar_sim.scene.scene",
    "SimulatedOdometry": "sonar_sim.scene.vehicle",
    "SimulatedPing": "sonar_sim.simulator",
    "Simulator": "sonar_sim.simulator",
    "SonarMotion": "sonar_sim.geometry.pose",
    "SonarSettings": "sonar_sim.scene.sonar",
    "Surface": "sonar_sim.scene.scene",
    "Tolerance": "sonar_sim.effects.image_difference",
    "Tour": "sonar_sim.geometry.trajectory",
    "Trajectory": "sonar_sim.geometry.trajectory",
    "Vehicle": "sonar_sim.scene.vehicle",
    "Water": "sonar_sim.scene.water",
    "Waypoint": "sonar_sim.geometry.trajectory",
    "World": "sonar_sim.world",
    "WorldPing": "sonar_sim.world",
    "load_scenario": "sonar_sim.scene_file",
    "scene_names": "sonar_sim.scene_file",
    "simulate": "sonar_sim.simulator",
    "sonar_preset": "sonar_sim.scene.sonar",
    "write_capture": "sonar_sim.capture",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
