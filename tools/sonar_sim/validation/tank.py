"""A round tank with one target in it, as in published comparisons of simulated and real pings.

Choi and others (2021) showed an Oculus M1200d's pings of an empty tank, a vertical rod, a
horizontal rod and a plate of 0.5 x 0.6 m. Their recordings are not public and their distances not
stated: these are ours.
"""

from typing import Final

import numpy as np
import trimesh

from sonar_sim.geometry.pose import Pose
from sonar_sim.material import MATERIALS
from sonar_sim.scene.scene import Scene, Sea, Surface

TANK_RADIUS_M: Final = 2.2
TANK_DEPTH_M: Final = 2.0
SONAR_X_M: Final = -1.0
TARGET_X_M: Final = 0.8
TARGET_RANGE_M: Final = TARGET_X_M - SONAR_X_M
WALL_RANGE_M: Final = TANK_RADIUS_M - SONAR_X_M
ROD_RADIUS_M: Final = 0.02
ROD_LENGTH_M: Final = 0.6
PLATE_M: Final = (0.02, 0.5, 0.6)
LYING: Final = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
TARGETS: Final = ("background", "vertical rod", "horizontal rod", "plate")


def tank_scene(target: str) -> Scene:
    """Build the tank, open above, with one of `TARGETS` at half its depth."""
    upright = [[TANK_RADIUS_M, -TANK_DEPTH_M / 2.0], [TANK_RADIUS_M, TANK_DEPTH_M / 2.0]]
    wall = trimesh.creation.revolve(upright, sections=120)
    bottom = trimesh.creation.cylinder(TANK_RADIUS_M, 0.02, sections=120)
    surfaces = [
        _surface("wall", wall, (0.0, 0.0, -TANK_DEPTH_M / 2.0), "concrete"),
        _surface("bottom", bottom, (0.0, 0.0, -TANK_DEPTH_M - 0.01), "concrete"),
    ]
    middle = (TARGET_X_M, 0.0, -TANK_DEPTH_M / 2.0)
    if target == "plate":
        surfaces.append(_surface(target, trimesh.creation.box(PLATE_M), middle, "aluminium"))
    elif target.endswith("rod"):
        rod = trimesh.creation.cylinder(ROD_RADIUS_M, ROD_LENGTH_M, sections=48)
        if target == "horizontal rod":
            rod.apply_transform(LYING)
        surfaces.append(_surface(target, rod, middle, "aluminium"))
    return Scene(tuple(surfaces), sea=Sea(rms_height_m=0.0))


def tank_pose() -> Pose:
    """Level, at half the tank's depth, looking at the target."""
    return Pose(np.array([SONAR_X_M, 0.0, -TANK_DEPTH_M / 2.0]), np.eye(3))


def _surface(
    name: str, mesh: trimesh.Trimesh, centre_m: tuple[float, float, float], material: str
) -> Surface:
    return Surface(
        name,
        np.asarray(mesh.vertices, dtype=np.float64) + np.array(centre_m),
        np.asarray(mesh.faces, dtype=np.int64),
        MATERIALS[material],
    )
