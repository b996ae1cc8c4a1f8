"""A scene: named surfaces of triangles, each of one material."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray


class Material(Enum):
    """Back scattering strength at normal incidence, 10 log mu, dB (Lambert's law).

    Orders of magnitude; published values at these frequencies scatter by 5 dB.
    """

    SAND = -25.0
    SHEET_PILING = -20.0
    RUSTY_STEEL = -17.0
    OVERGROWN_CONCRETE = -13.0

    @property
    def mu(self) -> float:
        """Lambert's coefficient as a ratio."""
        return float(10.0 ** (self.value / 10.0))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """One object's skin.

    Attributes:
        name: for people.
        vertices_m: (V, 3), map frame.
        faces: (F, 3), indices into the vertices.
        material: what it is made of.
    """

    name: str
    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that can echo."""

    surfaces: tuple[Surface, ...]

    @property
    def triangles_m(self) -> NDArray[np.float64]:
        """All triangles, (F, 3, 3), surface after surface."""
        none = np.empty((0, 3, 3))
        return np.concatenate([none, *(s.vertices_m[s.faces] for s in self.surfaces)])

    @property
    def face_mu(self) -> NDArray[np.float64]:
        """Lambert's coefficient of each triangle, (F,)."""
        counts = [len(surface.faces) for surface in self.surfaces]
        return np.repeat([surface.material.mu for surface in self.surfaces], counts)

    def save(self, path: Path) -> None:
        """Write all surfaces as one binary PLY."""
        triangles = self.triangles_m
        faces = np.arange(3 * len(triangles)).reshape(-1, 3)
        mesh = trimesh.Trimesh(triangles.reshape(-1, 3), faces, process=False)
        path.write_bytes(trimesh.exchange.ply.export_ply(mesh))
