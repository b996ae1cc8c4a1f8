"""A scene: everything that can echo, sound or mirror, and the water it is in."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from sonar_sim.errors import SceneError
from sonar_sim.geometry.trajectory import ObjectMotion
from sonar_sim.scene.material import Material
from sonar_sim.scene.water import Water

Triple = tuple[float, float, float]
SEA_CELL_M = 0.5
"""Edge of the squares in which a saved sea's surface is written."""
SEA_NEAR_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """One object's skin.

    Attributes:
        name: for people; unlike all others in the scene.
        vertices_m: (V, 3), in the object's frame; without a motion that is the map.
        faces: (F, 3), indices into the vertices.
        material: what it is made of.
        smooth: it is round between its vertices; else each face is flat and has edges.
        motion: how the object's frame moves; None stands still at the map's origin.

    Raises:
        SceneError: the arrays have other shapes, a vertex is not finite, an index is out of range.
    """

    name: str
    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material
    smooth: bool = False
    motion: ObjectMotion | None = None

    def __post_init__(self) -> None:
        vertices, faces = self.vertices_m, self.faces
        if vertices.ndim != 2 or vertices.shape[1] != 3:  # noqa: PLR2004 a table of points
            raise SceneError(f"surface {self.name!r}: vertices are {vertices.shape}, not (V, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3:  # noqa: PLR2004 a table of triangles
            raise SceneError(f"surface {self.name!r}: faces are {faces.shape}, not (F, 3)")
        wrong = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if len(wrong):
            raise SceneError(f"surface {self.name!r}: vertex {wrong[0]} is {vertices[wrong[0]]}")
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise SceneError(f"surface {self.name!r}: a face names a vertex that does not exist")

    def vertices_at_m(self, time_s: float) -> NDArray[np.float64]:
        """The vertices in the map at a time, (V, 3)."""
        if self.motion is None:
            return self.vertices_m
        pose = self.motion.pose(time_s)
        moved: NDArray[np.float64] = self.vertices_m @ pose.rotation.T + pose.position_m
        return moved


@dataclass(frozen=True, slots=True, eq=False)
class PointTarget:
    """Something too small for a mesh.

    Attributes:
        name: for people.
        position_m: in the object's frame; without a motion that is the map.
        target_strength_db: dB re 1 m², alike in all directions.
        motion: as of a surface.
    """

    name: str
    position_m: Triple
    target_strength_db: float
    motion: ObjectMotion | None = None

    def position_at_m(self, time_s: float) -> NDArray[np.float64]:
        """Position in the map at a time, (3,)."""
        here = np.asarray(self.position_m, dtype=np.float64)
        if self.motion is None:
            return here
        pose = self.motion.pose(time_s)
        moved: NDArray[np.float64] = pose.rotation @ here + pose.position_m
        return moved


@dataclass(frozen=True, slots=True)
class Emitter:
    """Another sonar or pinger, not synchronised with ours.

    Attributes:
        name: for people.
        position_m: in the map.
        frequency_hz, bandwidth_hz: of its sound.
        source_level_db: dB re 1 µPa at 1 m, towards us.
        period_s: between its transmissions.
        pulse_s: their length.
        offset_s: of its first transmission after time 0.
    """

    name: str
    position_m: Triple
    frequency_hz: float
    bandwidth_hz: float
    source_level_db: float
    period_s: float
    pulse_s: float
    offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Bubbles:
    """Gas in the water: `per_m3` bubbles of one radius."""

    radius_m: float
    per_m3: float


@dataclass(frozen=True, slots=True)
class Sediment:
    """Grains of quartz in the water, of one radius."""

    kg_per_m3: float
    radius_m: float = 5e-6


@dataclass(frozen=True, slots=True)
class CloudSpec:
    """Bubbles or sediment in a box along the map's axes.

    Attributes:
        name: for people.
        low_m, high_m: corners.
        matter: what is in it.
    """

    name: str
    low_m: Triple
    high_m: Triple
    matter: Bubbles | Sediment

    def __post_init__(self) -> None:
        if not all(low < high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise SceneError(f"cloud {self.name!r}: {self.low_m} is not below {self.high_m}")


@dataclass(frozen=True, slots=True)
class Sea:
    """The sea's surface at z = 0, seen from below.

    Attributes:
        rms_height_m: standard deviation of its height; some tenths of a millimetre make a mirror.
        lambert_db: its back scattering strength, bubbles under it included.
    """

    rms_height_m: float = 0.0
    lambert_db: float = -20.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that a ping can meet.

    Attributes:
        surfaces: that echo; their places in the tuple are their ids.
        targets: points that echo.
        emitters: that sound of themselves.
        clouds: in the water.
        water: what is between.
        sea: its upper end; None is too far to be heard.
    """

    surfaces: tuple[Surface, ...] = ()
    targets: tuple[PointTarget, ...] = ()
    emitters: tuple[Emitter, ...] = ()
    clouds: tuple[CloudSpec, ...] = ()
    water: Water = field(default_factory=Water)
    sea: Sea | None = None

    @property
    def triangles_m(self) -> NDArray[np.float64]:
        """All triangles at time 0, (F, 3, 3), surface after surface, map frame."""
        return self.triangles_at_m(0.0)

    def triangles_at_m(self, time_s: float) -> NDArray[np.float64]:
        """All triangles at a time, (F, 3, 3), surface after surface, map frame."""
        none = np.empty((0, 3, 3))
        return np.concatenate([none, *(s.vertices_at_m(time_s)[s.faces] for s in self.surfaces)])

    @property
    def face_surface(self) -> NDArray[np.int64]:
        """Place in `surfaces` of each triangle's surface, (F,)."""
        counts = [len(surface.faces) for surface in self.surfaces]
        return np.repeat(np.arange(len(counts)), counts)

    @property
    def face_mu(self) -> NDArray[np.float64]:
        """Lambert's coefficient of each triangle, (F,)."""
        mu = np.array([surface.material.mu for surface in self.surfaces], dtype=np.float64)
        return mu[self.face_surface]

    def save(self, path: Path, seen_m: NDArray[np.float64] | None = None) -> None:
        """Write what does not move as one binary PLY: a map can be no better than that.

        Args:
            path: of the file.
            seen_m: points that a sonar had in sight, (N, 3): the sea's surface has no end, and is
                written where they lie in it.
        """
        still = [s for s in self.surfaces if s.motion is None]
        parts = [np.empty((0, 3, 3)), *(s.vertices_m[s.faces] for s in still)]
        if self.sea is not None and seen_m is not None:
            parts.append(_sea_triangles(seen_m))
        triangles = np.concatenate(parts)
        faces = np.arange(3 * len(triangles)).reshape(-1, 3)
        mesh = trimesh.Trimesh(triangles.reshape(-1, 3), faces, process=False)
        path.write_bytes(trimesh.exchange.ply.export_ply(mesh))


def _sea_triangles(seen_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squares of the plane z = 0 in which points of it lie, in two triangles each, (F, 3, 3)."""
    afloat = np.abs(seen_m[:, 2]) < SEA_NEAR_M
    cells = np.unique(np.floor(seen_m[afloat, :2] / SEA_CELL_M), axis=0)
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
    triangles = np.zeros((len(cells), 6, 3))
    triangles[:, :, :2] = (cells[:, None] + corner) * SEA_CELL_M
    return triangles.reshape(-1, 3, 3)
