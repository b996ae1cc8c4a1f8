"""Mirrors: sound is reflected by a mirror's own faces, and nowhere else on its plane."""

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.physics import Mirror
from sonar_sim.raycast.fan import RayFan
from sonar_sim.raycast.meshes import Meshes

FLAT_M = 2e-3
"""A face of the mirror's surface belongs to the mirror if it lies no farther off its plane."""
PARALLEL = 0.9999
"""Cosine between a mirror's normal and its faces', at least."""
MIRROR_GAP_M = 0.02
"""An endless mirror is met though a mesh lies so near before it: the mesh stands for it."""
RELATIVE_GAP = 1e-3


def mirrored_fan(
    fan: RayFan, mirror: Mirror, image: FramePose, height_m: float, reach_m: float
) -> tuple[RayFan, NDArray[np.int64]]:
    """The part of a fan whose cells may meet the mirror from the sonar's image.

    Args:
        fan: of rays from the image.
        mirror: a plane, or a part of it.
        image: the sonar's mirror image.
        height_m: of the sonar over the plane.
        reach_m: maximum range to the plane.

    Returns:
        The part, and the ray of the whole fan that each of its rays is, (K,).
    """
    kept = _core.cells_through_window(
        fan.directions,
        fan.cell,
        np.append(image.rotation, image.position_m),
        np.append(mirror.normal, height_m),
        np.stack([mirror.low_m, mirror.high_m]),
        MIRROR_GAP_M,
        reach_m,
    )
    number = np.full(len(fan.directions) + 1, -1, dtype=np.int32)
    number[kept] = np.arange(len(kept))
    part = replace(
        fan,
        directions=fan.directions.take(kept, axis=0),
        cell=fan.cell.take(kept, axis=0),
        column=fan.column.take(kept),
        grid=replace(fan.grid, rays=number.take(fan.grid.rays)),
    )
    return part, kept


def reaches_mirror(
    meshes: Meshes,
    mirror: Mirror,
    face: NDArray[np.int32],
    range_m: NDArray[np.float32],
    crossing_m: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which rays reach the mirror unobstructed and hit its faces, (N,).

    Args:
        meshes: of the scene; mirrors stand still, so their faces are given in the map's frame.
        mirror: a plane, or some faces in it.
        face: that each ray met first; negative where none.
        range_m: to it.
        crossing_m: range at which each ray crosses the mirror's plane.
    """
    if mirror.surface is None:
        free: NDArray[np.bool_] = (face < 0) | (
            range_m > crossing_m * (1.0 - RELATIVE_GAP) - MIRROR_GAP_M
        )
        return free
    found: NDArray[np.bool_] = mirror_faces(meshes, mirror).take(face) & (face >= 0)
    return found


_FACES_CACHE: WeakKeyDictionary[Meshes, dict[bytes, NDArray[np.bool_]]] = WeakKeyDictionary()


def mirror_faces(meshes: Meshes, mirror: Mirror) -> NDArray[np.bool_]:
    """Which faces of its surface a mirror is made of, (F,)."""
    known = _FACES_CACHE.setdefault(meshes, {})
    name = np.array([mirror.surface, *mirror.point_m, *mirror.normal], dtype=np.float64).tobytes()
    faces = known.get(name)
    if faces is None:
        flat = np.abs(meshes.planes[:, :3] @ mirror.point_m - meshes.planes[:, 3]) < FLAT_M
        parallel = np.abs(meshes.planes[:, :3] @ mirror.normal) > PARALLEL
        faces = known[name] = (meshes.surface == mirror.surface) & flat & parallel
    return faces
