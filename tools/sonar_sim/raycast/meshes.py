"""The scene's triangles: in Embree for the rays, in tables for the echoes."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.errors import SceneError
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.geometry.pose import FramePose
from sonar_sim.scene.scene import Scene, Surface

SEA = -2
"""The sea's surface, where surfaces are numbered by their place in the scene."""
NOTHING = -1
MIN_AREA = 1e-14
"""Of a triangle, against the square of its scene's extent; smaller ones have no normal."""
START_OFFSET_M = 1e-4
"""So far from a sonar that lies in a face its rays begin."""
MIN_RAYS_PER_THREAD = 4096
"""Rays that are worth a thread of their own."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What rays met first, (N,) each.

    Attributes:
        range_m: infinite where they met nothing.
        face: in the table of faces; -1 where nothing.
        group: whose frame the face is given in.
    """

    range_m: NDArray[np.float32]
    face: NDArray[np.int32]
    group: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class FrameGroup:
    """Surfaces that share one frame: all that stand still, or one that moves.

    Attributes:
        embree: their triangles, moved by -centre_m.
        centre_m: keeps float32 precise in scenes far from the map's origin, (3,).
        pose: map_T_object at a time.
        first_face: in the table of faces.
        edges: of their triangles, moved by -centre_m.
        radius_m: of a ball about the centre that holds them.
    """

    embree: EmbreeScene
    mesh: TriangleMesh
    centre_m: NDArray[np.float64]
    pose: Callable[[float], FramePose]
    first_face: int
    edges: _core.EdgeTable
    radius_m: float

    def in_reach(
        self,
        map_T_object: FramePose,  # noqa: N803
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
        reach_m: float,
    ) -> bool:
        """Whether rays that start in a box, map frame, may meet a triangle."""
        centre_m = map_T_object.position_m + map_T_object.rotation @ self.centre_m
        away_m = centre_m - np.clip(centre_m, low_m, high_m)
        return float(np.linalg.norm(away_m)) < self.radius_m + reach_m

    def seen_from(self, map_T_sonar: FramePose, time_s: float) -> _core.MeshView:  # noqa: N803
        """The edges from a sonar's pose, at a time."""
        pose = self.pose(time_s)
        turn = map_T_sonar.rotation.T @ pose.rotation
        away_m = pose.position_m - map_T_sonar.position_m
        origin = map_T_sonar.rotation.T @ away_m + turn @ self.centre_m
        sonar = -pose.rotation.T @ away_m - self.centre_m
        return _core.MeshView(self.edges, np.concatenate([turn.ravel(), origin, sonar]))


class Meshes:
    """All geometry of a scene that rays can hit.

    Attributes:
        groups: by frame.
        planes: normal and offset of each face in its group's frame, (F, 4); the last is the sea's.
        normals: of the planes, float32, (F, 3).
        size_m: longest edge of each face, (F,); the sea has no edge.
        surface: of each face, by place in the scene, or `SEA`, (F,).
        material: of each face, index into the kernels' table, (F,).
        smooth: of each face that is round, its place in `curved_normals`, else -1, (F,).
        curved_normals: rows of G | g: a round face's normal at a point p is along G p + g, (B, 12).
        strengths: mu, squared reflection, roughness and slope of each material, (M, 4).
        faces: the kernels' table.
    """

    def __init__(self, scene: Scene) -> None:
        still = [i for i, surface in enumerate(scene.surfaces) if surface.motion is None]
        moving = [[i] for i, surface in enumerate(scene.surfaces) if surface.motion is not None]
        parts = [_MeshPart(scene, members) for members in ([still] if still else []) + moving]
        self._sea = scene.sea is not None
        self.groups: list[FrameGroup] = []
        count = 0
        for part in parts:
            self.groups.append(part.group(count))
            count += len(part.planes)
        sea_plane = np.array([[0.0, 0.0, 1.0, 0.0]])
        self.planes = np.concatenate([*(part.planes for part in parts), sea_plane])
        sizes = [*(part.size_m for part in parts), [np.inf]]
        self.size_m = np.concatenate(sizes).astype(np.float32)
        self.normals = self.planes[:, :3].astype(np.float32)
        self.surface = np.concatenate([*(part.surface for part in parts), [SEA]]).astype(np.int32)
        curved = [part.curved_normals for part in parts]
        smooth = np.full(len(self.planes), -1, dtype=np.int32)
        is_curved = np.concatenate([*(part.is_curved for part in parts), [False]])
        smooth[is_curved] = np.arange(np.count_nonzero(is_curved))
        self.material = np.where(self.surface == SEA, len(scene.surfaces), self.surface)
        self.curved_normals = np.concatenate([np.empty((0, 12)), *curved])
        self.smooth = smooth
        self.strengths = _materials(scene)
        self.faces = _core.FaceTable(
            self.planes,
            (self.material + 1).astype(np.uint32),
            self.material.astype(np.int32),
            smooth,
            self.curved_normals,
            self.strengths,
        )

    @property
    def sea_group(self) -> int:
        """The sea is given in the map's frame, after all groups."""
        return len(self.groups)

    def poses(self, time_s: float) -> list[FramePose]:
        """map_T_object of each group and of the sea."""
        here = FramePose(np.zeros(3), np.eye(3))
        return [*(group.pose(time_s) for group in self.groups), here]

    def cast(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        time_s: float,
        reach_m: float | NDArray[np.float32],
        threads: int = 2,
    ) -> Hits:
        """What rays meet first.

        Args:
            origin_m: map frame, (3,) or (N, 3).
            direction: unit vectors, map frame, (N, 3).
            time_s: at which moving objects are met.
            reach_m: what lies farther is not met, one or (N,).
            threads: that share the rays.
        """
        count = len(direction)
        parts = min(threads, max(1, count // MIN_RAYS_PER_THREAD))
        cuts = [(count * i // parts, count * (i + 1) // parts) for i in range(parts)]

        def work(cut: tuple[int, int]) -> Hits:
            part = slice(*cut)
            origin = origin_m if origin_m.ndim == 1 else origin_m[part]
            reach = reach_m[part] if isinstance(reach_m, np.ndarray) else reach_m
            return self._cast(origin, direction[part], time_s, reach)

        if parts == 1:
            return work(cuts[0])
        with ThreadPoolExecutor(parts) as pool:
            met = list(pool.map(work, cuts))
        return Hits(
            np.concatenate([m.range_m for m in met]),
            np.concatenate([m.face for m in met]),
            np.concatenate([m.group for m in met]),
        )

    def _cast(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        time_s: float,
        reach_m: float | NDArray[np.float32],
    ) -> Hits:
        count = len(direction)
        nearest = np.full(count, np.inf, dtype=np.float32)
        face = np.full(count, NOTHING, dtype=np.int32)
        owner = np.zeros(count, dtype=np.int32)
        longest_m = float(np.max(reach_m, initial=0.0))
        # One axis after the other: along the first of two axes numpy takes ten times as long.
        starts = np.atleast_2d(origin_m).T if count else np.zeros((3, 1))
        low_m, high_m = (np.array([end(axis) for axis in starts]) for end in (np.min, np.max))
        for number, group in enumerate(self.groups):
            pose = group.pose(time_s)
            if not group.in_reach(pose, low_m, high_m, longest_m):
                continue
            range_m, found = _run(group, pose, origin_m, direction)
            nearer = (found >= 0) & (range_m < nearest)
            nearest[nearer] = range_m[nearer]
            face[nearer] = found[nearer] + group.first_face
            owner[nearer] = number
        if self._sea:
            self._meet_sea(origin_m, direction, nearest, face, owner)
        face[~(nearest < reach_m)] = NOTHING
        return Hits(nearest, face, owner)

    def _meet_sea(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        nearest: NDArray[np.float32],
        face: NDArray[np.int32],
        owner: NDArray[np.int32],
    ) -> None:
        """The sea's surface is the plane z = 0, met from below."""
        height = -np.asarray(origin_m)[..., 2]
        rising = np.maximum(direction[:, 2], np.float32(1e-9))
        range_m = (height / rising).astype(np.float32)
        meets = (direction[:, 2] > 0.0) & (height > 0.0) & (range_m < nearest)
        nearest[meets] = range_m[meets]
        face[meets] = len(self.planes) - 1
        owner[meets] = self.sea_group


def _run(
    group: FrameGroup,
    map_T_object: FramePose,  # noqa: N803
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Ranges and faces of a group that rays of the map meet."""
    turn = map_T_object.rotation
    start = origin_m - map_T_object.position_m
    still = np.array_equal(turn, np.eye(3))
    if not still:
        start = chunked_matmul(np.atleast_2d(start), turn)
        direction = chunked_matmul(direction, turn.astype(np.float32))
    start = start - group.centre_m
    origins = np.empty((len(direction), 3), dtype=np.float32)
    origins[:] = start
    found = group.embree.run(origins, np.ascontiguousarray(direction), output=True)
    range_m, face = found["tfar"], found["primID"].astype(np.int32)
    # A sonar in the plane of a face would see nothing else, on either side of it.
    blind = np.flatnonzero((face >= 0) & (range_m <= 0.0)) if origin_m.ndim == 1 else ()
    if len(blind):
        ahead = origins[blind] + np.float32(START_OFFSET_M) * direction[blind]
        found = group.embree.run(ahead, np.ascontiguousarray(direction[blind]), output=True)
        range_m[blind], face[blind] = found["tfar"] + np.float32(START_OFFSET_M), found["primID"]
    return range_m, face


class _MeshPart:
    """Faces of some surfaces, on their way into the tables."""

    def __init__(self, scene: Scene, members: list[int]) -> None:
        surfaces = [scene.surfaces[i] for i in members]
        self._pose = _pose_of(surfaces[0])
        corners = np.concatenate([s.vertices_m[s.faces] for s in surfaces])
        if not np.isfinite(corners).all():
            raise SceneError(f"surface {surfaces[0].name!r} or one beside it: a vertex not finite")
        counts = [len(s.faces) for s in surfaces]
        curved = [_curved_normals(s) if s.smooth else np.empty((0, 12)) for s in surfaces]
        is_curved = np.repeat([s.smooth for s in surfaces], counts)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1)
        extent = np.ptp(corners.reshape(-1, 3), axis=0).max() if len(corners) else 0.0
        keep = length > MIN_AREA * extent**2
        self.surface = np.repeat(members, counts)[keep]
        self.curved_normals = np.concatenate(curved)[keep[is_curved]]
        self.is_curved = is_curved[keep]
        self._corners = corners[keep]
        normal = cross[keep] / length[keep, None]
        edges = self._corners - np.roll(self._corners, 1, axis=1)
        self.size_m = np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0)
        middle = self._corners.mean(axis=1)
        self.planes = np.concatenate([normal, np.sum(normal * middle, axis=1)[:, None]], axis=1)

    def group(self, first_face: int) -> FrameGroup:
        points = self._corners.reshape(-1, 3)
        centre = (points.min(axis=0) + points.max(axis=0)) / 2.0 if len(points) else np.zeros(3)
        embree = EmbreeScene()
        corners = (self._corners - centre).astype(np.float32)
        mesh = TriangleMesh(embree, corners)
        edges = _core.EdgeTable(
            corners, self.planes[:, :3].astype(np.float32), self.surface.astype(np.int32)
        )
        # A little more: corners and ranges are rounded.
        radius = 1.001 * float(np.linalg.norm(corners, axis=-1).max(initial=0.0))
        return FrameGroup(embree, mesh, centre, self._pose, first_face, edges, radius)


def _pose_of(surface: Surface) -> Callable[[float], FramePose]:
    if surface.motion is not None:
        return surface.motion.pose
    here = FramePose(np.zeros(3), np.eye(3))
    return lambda _time_s: here


def _materials(scene: Scene) -> NDArray[np.float64]:
    """mu, squared reflection, roughness, slope of each surface and of the sea."""
    rows = [
        (m.mu, m.reflection**2, m.roughness_m, m.slope_rad)
        for m in (surface.material for surface in scene.surfaces)
    ]
    sea_mu = 0.0 if scene.sea is None else 10.0 ** (scene.sea.lambert_db / 10.0)
    return np.array([*rows, (sea_mu, 0.0, 0.0, 1.0)], dtype=np.float64)


def _curved_normals(surface: Surface) -> NDArray[np.float64]:
    """Rows of G | g for each face: the vertices' normals, linear over the face, (F, 12)."""
    corners = surface.vertices_m[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(surface.vertices_m)
    for corner in range(3):
        np.add.at(normals, surface.faces[:, corner], cross)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    at = normals[surface.faces]
    # Over the face: n = n0 + a (n1 - n0) + b (n2 - n0), a and b linear in the point.
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    weights = np.linalg.pinv(edges)
    changes = np.stack([at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]], axis=2)
    slope = changes @ weights
    constant = at[:, 0] - np.einsum("fij,fj->fi", slope, corners[:, 0])
    table: NDArray[np.float64] = np.concatenate([slope, constant[:, :, None]], axis=2)
    return table.reshape(-1, 12)
