"""A depth camera in the sonar's place: one ray per pixel, cast with Embree.

Optical frame: x right, y down, z ahead. The sonar frame's x is ahead, y to port, z up.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from sonar_sim.geometry.pose import FramePose
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings

OPTICAL_FROM_SONAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
MAX_ASIDE_RAD = math.radians(80.0)
"""A pinhole's pixels grow without bound towards 90° from its axis."""


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A camera without distortion, its axis through the picture's middle.

    Attributes:
        width, height: pixels.
        horizontal_rad: field of view across; the one up and down follows from the picture's shape.
        near_m, far_m: depths between which something is seen.
    """

    width: int
    height: int
    horizontal_rad: float
    near_m: float = 0.1
    far_m: float = math.inf

    @property
    def focal_px(self) -> float:
        """Focal length, W / (2 tan(FOV / 2))."""
        return self.width / (2.0 * math.tan(self.horizontal_rad / 2.0))

    @property
    def vertical_rad(self) -> float:
        """Field of view up and down."""
        return 2.0 * math.atan(self.height / (2.0 * self.focal_px))

    @property
    def centre_px(self) -> tuple[float, float]:
        """Where the axis goes through the picture; pixel 0's middle is 0."""
        return (self.width - 1) / 2.0, (self.height - 1) / 2.0

    def rays(self) -> NDArray[np.float64]:
        """Direction of each pixel in the sonar frame, (height, width, 3), x = 1: not unit."""
        centre_x, centre_y = self.centre_px
        across = (np.arange(self.width) - centre_x) / self.focal_px
        down = (np.arange(self.height) - centre_y) / self.focal_px
        x, y = np.meshgrid(across, down)
        return np.stack([np.ones_like(x), -x, -y], axis=-1)


def pinhole_of(sonar: SonarSettings, width: int = 640) -> Pinhole:
    """Cover the sonar's fan, and up and down twice its vertical -3 dB width."""
    half_rad = min(sonar.half_aperture_rad, MAX_ASIDE_RAD)
    focal_px = width / (2.0 * math.tan(half_rad))
    up_rad = min(sonar.vertical_width_rad, MAX_ASIDE_RAD)
    height = max(2, 2 * round(focal_px * math.tan(up_rad)))
    return Pinhole(width, height, 2.0 * half_rad, near_m=0.1, far_m=sonar.range_m)


@dataclass(frozen=True, slots=True, eq=False)
class DepthImage:
    """What the pixels see; all arrays are (height, width, ...).

    Attributes:
        camera: that looked.
        depth_m: float32, along the axis; 0 where nothing is.
        range_m: float32, along the ray; 0 where nothing is.
        normals: float32 (…, 3), unit, optical frame, towards the camera; 0 where nothing is.
        cos_incidence: float32, between ray and normal; 0 where nothing is.
        surface: int32, place in the scene's surfaces; -1 where nothing is.
    """

    camera: Pinhole
    depth_m: NDArray[np.float32]
    range_m: NDArray[np.float32]
    normals: NDArray[np.float32] = field(repr=False)
    cos_incidence: NDArray[np.float32] = field(repr=False)
    surface: NDArray[np.int32] = field(repr=False)

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Where something is, (height, width)."""
        return self.surface >= 0

    def points_m(self) -> NDArray[np.float64]:
        """Points that were seen, sonar frame, (N, 3), pixel after pixel."""
        points: NDArray[np.float64] = (self.camera.rays() * self.depth_m[..., None])[self.hit]
        return points


class DepthCamera:
    """A depth camera in a scene at one time, for any pose."""

    def __init__(self, scene: Scene, time_s: float = 0.0) -> None:
        triangles = scene.triangles_at_m(time_s)
        self._surface = scene.face_surface.astype(np.int32)
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(length, np.finfo(np.float64).tiny)
        self._scene = EmbreeScene()
        self._mesh = None
        if len(triangles):
            self._mesh = TriangleMesh(self._scene, triangles.astype(np.float32))

    def look(self, camera: Pinhole, map_T_sonar: FramePose) -> DepthImage:  # noqa: N803
        """Cast the camera's rays; what lies outside its near and far planes is not seen."""
        rays = camera.rays().reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        away_m, face = self._cast(rays / length[:, None], map_T_sonar)
        depth_m = away_m / length
        seen = (face >= 0) & (depth_m >= camera.near_m) & (depth_m <= camera.far_m)
        shape = (camera.height, camera.width)
        normals = np.zeros_like(rays)
        normals[seen] = self._normals[face[seen]] @ map_T_sonar.rotation
        facing = np.sum(normals * rays, axis=1) / length
        normals *= -np.sign(facing)[:, None]
        surface = np.full(len(rays), -1, dtype=np.int32)
        surface[seen] = self._surface[face[seen]]
        optical = (normals @ OPTICAL_FROM_SONAR.T).astype(np.float32)
        return DepthImage(
            camera,
            np.where(seen, depth_m, 0.0).astype(np.float32).reshape(shape),
            np.where(seen, away_m, 0.0).astype(np.float32).reshape(shape),
            optical.reshape(*shape, 3),
            np.abs(facing).astype(np.float32).reshape(shape),
            surface.reshape(shape),
        )

    def _cast(
        self,
        directions: NDArray[np.float64],
        map_T_sonar: FramePose,  # noqa: N803
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Slant range and triangle of each unit direction; triangle -1 is nothing."""
        if self._mesh is None:
            return np.zeros(len(directions)), np.full(len(directions), -1, dtype=np.int64)
        turned = directions @ map_T_sonar.rotation.T
        origins = np.broadcast_to(map_T_sonar.position_m, turned.shape)
        found = self._scene.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(turned, dtype=np.float32),
            output=True,
        )
        return found["tfar"].astype(np.float64), found["primID"].astype(np.int64)
