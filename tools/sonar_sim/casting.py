"""Which surface each direction meets first: Embree over a fixed fan of rays."""

import math
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from sonar_sim.poses import Pose
from sonar_sim.scene import Scene
from sonar_sim.sonar import SonarSettings

MAX_ELEVATION_RAD = math.radians(40.0)
"""Out to the vertical pattern's first side lobe and a little beyond."""
ELEVATIONS = 112
MARGIN_BEAMS = 12
"""Columns traced beyond each outermost beam: their main lobes reach out there."""


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Directions of the rays in the sonar frame: a grid over two direction cosines.

    A line array measures the component of a direction along itself, which is cos(e) sin(b) and
    not sin(b): an echo off the fan's plane shows at the bearing of its cone. So the grid is uniform
    in s = -y (starboard) and w = z (up), and a cell covers ds dw / x of solid angle.

    Attributes:
        directions: unit vectors, (N, 3).
        column: each ray's column of the echo grid, 0 .. `columns`, (N,).
        columns: beams and a margin on both sides.
        sine_step, up_step: edges of a cell in s and w.
    """

    directions: NDArray[np.float64]
    column: NDArray[np.int64]
    columns: int
    sine_step: float
    up_step: float

    @property
    def solid_angle_sr(self) -> NDArray[np.float64]:
        """Of each ray, (N,)."""
        return self.sine_step * self.up_step / self.directions[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The rays that met something within range.

    Attributes:
        ray: index into the fan, (H,).
        range_m: slant range, (H,).
        normal: unit normals in the sonar frame, (H, 3); their side means nothing.
        mu: Lambert's coefficient, (H,).
    """

    ray: NDArray[np.int64]
    range_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    mu: NDArray[np.float64]


def fan_of(sonar: SonarSettings, elevations: int = ELEVATIONS) -> Fan:
    """Lay the rays: one a beam pitch across, evenly over the sine of elevation."""
    columns = sonar.beams + 2 * MARGIN_BEAMS
    s = (np.arange(columns) - (columns - 1) / 2.0) * sonar.sine_pitch
    top = math.sin(MAX_ELEVATION_RAD)
    up_step = 2.0 * top / elevations
    w = (np.arange(elevations) + 0.5) * up_step - top
    ss, ww = np.meshgrid(s, w, indexing="ij")
    column = np.broadcast_to(np.arange(columns)[:, None], ss.shape)
    ahead = 1.0 - ss**2 - ww**2
    # Cones near the array's axis hold no direction at high elevation.
    real = ahead > np.square(sonar.sine_pitch)
    directions = np.stack([np.sqrt(ahead[real]), -ss[real], ww[real]], axis=1)
    return Fan(directions, column[real], columns, sonar.sine_pitch, up_step)


class Caster:
    """A scene in Embree's hands."""

    def __init__(self, scene: Scene) -> None:
        triangles = scene.triangles_m
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self._mu = scene.face_mu
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, triangles.astype(np.float32))

    def cast(self, fan: Fan, map_T_sonar: Pose, range_m: float) -> Hits:  # noqa: N803
        """Cast the fan from a pose; what lies farther than `range_m` is left out."""
        turned = fan.directions @ map_T_sonar.rotation.T
        origins = np.broadcast_to(map_T_sonar.position_m, turned.shape)
        found = self._scene.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(turned, dtype=np.float32),
            output=True,
        )
        hit = np.flatnonzero((found["primID"] >= 0) & (found["tfar"] < range_m))
        face = found["primID"][hit]
        return Hits(
            ray=hit,
            range_m=found["tfar"][hit].astype(np.float64),
            normal=self._normals[face] @ map_T_sonar.rotation,
            mu=self._mu[face],
        )
