"""Single casts for the rules: what each ray meets first."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.raycast import meshes

SEA = -1
"""Surface number of the sea's surface."""
NOTHING = -2
SKIP_M = 1e-3
"""A second cast starts this far behind the first hit, so as not to meet the same face again."""


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """What rays met.

    Attributes:
        range_m: along the ray, inf for nothing, (N,).
        normal: unit, map frame; its side means nothing, (N, 3).
        surface: place in the scene's surfaces, or `SEA`, or `NOTHING`, (N,).
        turn: of the curvatures: sum of squares, 1/m²; square of the product, 1/m⁴; square of how
            fast the normal turns along the ray's own part in the tangent plane, 1/m², (N, 3).
    """

    range_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    surface: NDArray[np.int64]
    turn: NDArray[np.float64]


def cast(
    scene: meshes.Meshes,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    time_s: float,
    reach_m: float,
) -> Met:
    """Find what rays meet first.

    Args:
        scene: its triangles.
        origin_m: map frame, (3,) or (N, 3).
        direction: unit vectors, map frame, (N, 3).
        time_s: at which moving objects are met.
        reach_m: what lies farther is not met.
    """
    found = scene.cast(origin_m, direction.astype(np.float32), time_s, reach_m, threads=1)
    hit = found.face >= 0
    face = found.face[hit]
    range_m = np.where(hit, found.range_m, np.inf).astype(np.float64)
    start_m = origin_m if origin_m.ndim == 1 else origin_m[hit]
    point_m = start_m + direction[hit] * range_m[hit, None]
    normal = np.zeros((len(hit), 3))
    normal[hit] = _normals(scene, face, found.group[hit], point_m, time_s)
    surface = np.full(len(hit), NOTHING, dtype=np.int64)
    number = scene.surface[face]
    surface[hit] = np.where(number == meshes.SEA, SEA, number)
    turn = np.zeros((len(hit), 3))
    tangent = direction[hit] - np.sum(direction[hit] * normal[hit], axis=1)[:, None] * normal[hit]
    turn[hit] = _turn(scene, face, found.group[hit], tangent, time_s)
    return Met(range_m, normal, surface, turn)


def _turn(
    scene: meshes.Meshes,
    face: NDArray[np.int32],
    group: NDArray[np.int32],
    tangent: NDArray[np.float64],
    time_s: float,
) -> NDArray[np.float64]:
    """As in `Met`: the normal's gradient has the principal curvatures as its eigenvalues."""
    turn = np.zeros((len(face), 3))
    place = scene.smooth[face]
    round_ = np.flatnonzero(place >= 0)
    if len(round_) == 0:
        return turn
    gradient = scene.bent[place[round_]].reshape(-1, 3, 4)[:, :, :3]
    squares = np.einsum("nij,nij->n", gradient, gradient)
    trace = np.einsum("nii->n", gradient)
    local = _turned_back(scene, tangent[round_], group[round_], time_s)
    turn[round_, 0] = squares
    turn[round_, 1] = np.square((np.square(trace) - squares) / 2.0)
    turn[round_, 2] = np.sum(np.square(np.einsum("nji,nj->ni", gradient, local)), axis=1)
    return turn


def _turned_back(
    scene: meshes.Meshes, vectors: NDArray[np.float64], group: NDArray[np.int32], time_s: float
) -> NDArray[np.float64]:
    """Vectors of the map in the frames of their groups, (N, 3)."""
    local = vectors
    for number, pose in enumerate(scene.poses(time_s)):
        if not np.array_equal(pose.rotation, np.eye(3)):
            its = group == number
            local = np.where(its[:, None], vectors @ pose.rotation, local)
    return local


def _normals(
    scene: meshes.Meshes,
    face: NDArray[np.int32],
    group: NDArray[np.int32],
    point_m: NDArray[np.float64],
    time_s: float,
) -> NDArray[np.float64]:
    """Unit normals in the map frame, (N, 3); round faces have another one at each point."""
    normal = scene.planes[face, :3]
    place = scene.smooth[face]
    round_ = np.flatnonzero(place >= 0)
    poses = scene.poses(time_s)
    if len(round_):
        its = group[round_]
        local_m = np.empty((len(round_), 3))
        for number, pose in enumerate(poses):
            of_it = its == number
            local_m[of_it] = (point_m[round_[of_it]] - pose.position_m) @ pose.rotation
        table = scene.bent[place[round_]].reshape(-1, 3, 4)
        bent = np.einsum("nij,nj->ni", table[:, :, :3], local_m) + table[:, :, 3]
        normal[round_] = bent / np.maximum(np.linalg.norm(bent, axis=1, keepdims=True), 1e-30)
    for number, pose in enumerate(poses):
        if not np.array_equal(pose.rotation, np.eye(3)):
            its = group == number
            normal[its] = normal[its] @ pose.rotation.T
    return normal
