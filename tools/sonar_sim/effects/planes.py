"""Planes of a scene that could mirror sound: the calm sea, tank walls, tiled floors."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.mirror import FLAT_M, PARALLEL
from sonar_sim.raycast.meshes import SEA
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

MAX_PLANES = 8
MIN_AREA_M2 = 0.2
MIN_REFLECTION = 0.03
"""Of pressure, coherence included, at `GRAZING_COSINE`: less is 30 dB down on each bounce."""
GRAZING_COSINE = 0.1
STEP = 0.01
"""Normals and offsets (m) that agree to this are looked at together."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPlane:
    """One plane.

    Attributes:
        point_m, normal: map frame; the side is not known yet.
        low_m, high_m: box around its faces, map frame.
        reflection: of pressure, signed, without coherence.
        roughness_m: standard deviation of its height.
        surface: whose faces it is made of, by place in the scene, or `meshes.SEA`.
    """

    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]
    reflection: float
    roughness_m: float
    surface: int


def coherence(
    wave_number_per_m: float, roughness_m: float, cos_incidence: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Part of the pressure that a rough plane mirrors: exp(-2 k² h² cos² i)."""
    phase = wave_number_per_m * roughness_m * cos_incidence
    part: NDArray[np.float64] = np.exp(-2.0 * np.square(phase))
    return part


def mirror_planes(scene: Scene, sonar: SonarSettings) -> tuple[MirrorPlane, ...]:
    """The sea and the largest planes of what is smooth enough and does not move."""
    k = 2.0 * math.pi * sonar.frequency_hz / scene.water.speed_of_sound_mps
    planes = []
    if scene.sea is not None:
        far = np.array([1e6, 1e6, 0.0])
        down = np.array([0.0, 0.0, -1.0])
        planes.append(MirrorPlane(np.zeros(3), down, -far, far, -1.0, scene.sea.rms_height_m, SEA))
    for number, surface in enumerate(scene.surfaces):
        material = surface.material
        left = coherence(k, material.roughness_m, np.array(GRAZING_COSINE))
        bright = abs(material.reflection) * float(left) > MIN_REFLECTION
        if bright and surface.motion is None and not surface.smooth and len(surface.faces):
            planes += _planes_of(surface, number)
    return tuple(planes)


def _planes_of(surface: Surface, number: int) -> list[MirrorPlane]:
    """The largest planes; each face in one of them at most, or its ghosts would show twice."""
    triangles = surface.vertices_m[surface.faces]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(across, axis=1)
    triangles, across, length = (values[length > 0.0] for values in (triangles, across, length))
    normal = across / length[:, None]
    offset = np.sum(normal * triangles[:, 0], axis=1)
    key = np.rint(np.column_stack([normal, offset]) / STEP).astype(np.int64)
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    largest = np.argsort(-np.bincount(group.ravel(), length), kind="stable")
    left = np.ones(len(triangles), dtype=np.bool_)
    planes: list[MirrorPlane] = []
    for face in first[largest[: 2 * MAX_PLANES]]:
        if not left[face]:
            continue
        flat = np.abs(normal @ triangles[face, 0] - offset) < FLAT_M
        faces = left & flat & (np.abs(normal @ normal[face]) > PARALLEL)
        left &= ~faces
        if length[faces].sum() / 2.0 >= MIN_AREA_M2 and len(planes) < MAX_PLANES:
            planes.append(_plane(surface, number, triangles[faces], normal[face]))
    return planes


def _plane(
    surface: Surface, number: int, triangles_m: NDArray[np.float64], normal: NDArray[np.float64]
) -> MirrorPlane:
    corners = triangles_m.reshape(-1, 3)
    return MirrorPlane(
        triangles_m[0, 0],
        normal,
        corners.min(axis=0),
        corners.max(axis=0),
        surface.material.reflection,
        surface.material.roughness_m,
        number,
    )
