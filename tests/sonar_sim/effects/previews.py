"""Scenes and views that the tests of the rules share."""

import numpy as np
from sonar_sim.effects.effect import RuleResult
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.scene.material import MATERIALS, Material
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

SONAR = SonarSettings()
LOUD = SonarSettings(gain_percent=75.0)


def rectangle(
    name: str, corners: list[tuple[float, float, float]], material: Material | None = None
) -> Surface:
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Surface(name, np.array(corners, dtype=float), faces, material or MATERIALS["sand"])


def floor(depth_m: float = 5.0, half_m: float = 200.0, material: Material | None = None) -> Surface:
    h, z = half_m, -depth_m
    return rectangle("floor", [(-h, -h, z), (h, -h, z), (h, h, z), (-h, h, z)], material)


def wall(x_m: float, material: Material | None = None, half_m: float = 20.0) -> Surface:
    h = half_m
    corners = [(x_m, -h, -h), (x_m, h, -h), (x_m, h, h), (x_m, -h, h)]
    return rectangle("wall", corners, material)


def pose(depth_m: float = 3.0) -> FramePose:
    return FramePose(np.array([0.0, 0.0, -depth_m]), np.eye(3))


def motion(forward_mps: float = 0.0, turn_dps: float = 0.0) -> SonarMotion:
    return SonarMotion(
        np.array([forward_mps, 0.0, 0.0]), np.array([0.0, 0.0, np.radians(turn_dps)])
    )


def view_of(
    *surfaces: Surface,
    sonar: SonarSettings = SONAR,
    scene: Scene | None = None,
    at: FramePose | None = None,
    moving: SonarMotion | None = None,
    time_s: float = 0.0,
) -> PingPreview:
    shown = scene or Scene(surfaces)
    return Previewer(shown, sonar).at(at or pose(), 0, time_s, moving)


def verdict(name: str, view: PingPreview, tolerance: Tolerance | None = None) -> RuleResult:
    decided: RuleResult = EFFECTS[name].decide(view, tolerance or Tolerance())
    return decided
