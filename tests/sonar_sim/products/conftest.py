import math

import numpy as np
import pytest
from sonar_sim.geometry.pose import FramePose
from sonar_sim.products import PingProducts, ProductRenderer
from sonar_sim.raycast.depth_camera import Pinhole
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

FACES = np.array([[0, 1, 2], [0, 2, 3]])


def upright(name: str, ahead_m: float, port_m: float, half_m: float, material: str) -> Surface:
    corners = [(-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m)]
    vertices = np.array([[ahead_m, port_m + y, z] for y, z in corners])
    return Surface(name, vertices, FACES, MATERIALS[material])


@pytest.fixture(scope="session")
def scene() -> Scene:
    """A board to starboard before a wall: nothing else."""
    return Scene((upright("wall", 5.0, 0.0, 2.0, "mud"), upright("board", 3.0, -0.6, 0.3, "rock")))


@pytest.fixture(scope="session")
def sonar() -> SonarSettings:
    return SonarSettings(beams=128, demanded_range_m=8.0, base_row_m=0.02, gain_percent=60.0)


@pytest.fixture(scope="session")
def sounding(scene: Scene, sonar: SonarSettings) -> PingProducts:
    camera = Pinhole(96, 60, math.radians(90.0), far_m=sonar.range_m)
    pose = FramePose(np.zeros(3), np.eye(3))
    return ProductRenderer(scene, sonar, camera, seed=3).at(pose, ping_id=7, time_s=1.5)
