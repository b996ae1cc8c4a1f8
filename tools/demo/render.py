"""Draw triangles in perspective, by casting one ray a pixel."""

import math
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

LIGHT = np.array([-0.45, -0.6, 0.66])
AMBIENT = 0.5
FOG = 2.0
"""Where the water has swallowed 63 % of a surface's colour: times the eye's distance to what it
looks at."""
SHADOW_LIFT_M = 0.02


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole that looks from one point to another, up being +z.

    Attributes:
        eye_m, target_m: positions.
        width, height: of the picture, pixels.
        field_of_view_deg: horizontal.
    """

    eye_m: tuple[float, float, float]
    target_m: tuple[float, float, float]
    width: int = 1000
    height: int = 720
    field_of_view_deg: float = 42.0

    def rays(self) -> NDArray[np.float64]:
        """Unit directions, (height * width, 3), row by row from the top left."""
        forward = np.subtract(self.target_m, self.eye_m)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        half = math.tan(math.radians(self.field_of_view_deg) / 2.0)
        across = np.linspace(-half, half, self.width)
        down = np.linspace(half, -half, self.height) * self.height / self.width
        rays = forward + across[None, :, None] * right + down[:, None, None] * up
        unit: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        return unit.reshape(-1, 3)


def render(
    triangles_m: NDArray[np.float64],
    colours: NDArray[np.float64],
    camera: Camera,
    water: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Draw.

    Args:
        triangles_m: (F, 3, 3).
        colours: of each triangle, (F, 3), 0..1.
        camera: where from.
        water: colour of nothing, and of the far.

    Returns:
        Picture (height, width, 3), 0..1.
    """
    scene = EmbreeScene()
    mesh = TriangleMesh(scene, triangles_m.astype(np.float32))
    rays = camera.rays()
    origins = np.broadcast_to(np.asarray(camera.eye_m), rays.shape)
    distance, face = _cast(scene, origins, rays)
    hit = face >= 0
    normal = _normals(triangles_m[face[hit]], rays[hit])
    points = origins[hit] + rays[hit] * distance[hit, None] + SHADOW_LIFT_M * normal
    _, blocker = _cast(scene, points, np.broadcast_to(LIGHT, points.shape))
    lit = np.clip(normal @ LIGHT, 0.0, None) * (blocker < 0)
    shaded = colours[face[hit]] * (AMBIENT + (1.0 - AMBIENT) * lit)[:, None]
    fog_m = FOG * float(np.linalg.norm(np.subtract(camera.target_m, camera.eye_m)))
    clear = np.exp(-np.square(distance[hit] / fog_m))[:, None]
    picture = np.broadcast_to(np.asarray(water), rays.shape).copy()
    picture[hit] = shaded * clear + np.asarray(water) * (1.0 - clear)
    del mesh  # Embree reads it until here
    shaped: NDArray[np.float64] = picture.reshape(camera.height, camera.width, 3)
    return shaped


def cubes(centres_m: NDArray[np.float64], edge_m: float) -> NDArray[np.float64]:
    """Triangles of cubes around points, (12 N, 3, 3), twelve a cube in order."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5
    faces = np.array(
        [
            [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
            [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
        ]
    )  # fmt: skip
    solid = corner[faces] * edge_m
    placed: NDArray[np.float64] = centres_m[:, None, None, :] + solid[None]
    return placed.reshape(-1, 3, 3)


def _cast(
    scene: EmbreeScene, origins_m: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    found = scene.run(
        np.ascontiguousarray(origins_m, dtype=np.float32),
        np.ascontiguousarray(directions, dtype=np.float32),
        output=True,
    )
    return found["tfar"].astype(np.float64), found["primID"].astype(np.int64)


def _normals(triangles_m: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals on the side that the ray comes from."""
    normal = np.cross(triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    away = np.sum(normal * rays, axis=1) > 0.0
    normal[away] *= -1.0
    return normal
