"""The scene's triangles: for the rays to meet, and in tables for the echoes.

Rays of one origin meet triangles that are projected onto them; for all others there is Embree.
"""

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

    @classmethod
    def empty(cls, count: int, range_m: float) -> "Hits":
        """No hits yet, and the maximum range at which there may be some."""
        face = np.full(count, NOTHING, dtype=np.int32)
        return cls(np.full(count, range_m, np.float32), face, np.zeros(count, dtype=np.int32))

    def take(self, rays: NDArray[np.int64]) -> "Hits":
        """Those of some rays."""
        return Hits(self.range_m.take(rays), self.face.take(rays), self.group.take(rays))


@dataclass(frozen=True, slots=True, eq=False)
class FrameGroup:
    """Surfaces that share one frame: all that stand still, or one that moves.

    Attributes:
        triangles: moved by -centre_m, for rays of one origin.
        embree: the same, for all others.
        centre_m: keeps float32 precise in scenes far from the map's origin, (3,).
        pose: map_T_object at a time.
        first_face: in the table of faces.
        edges: of their triangles, moved by -centre_m.
        radius_m: of a ball about the centre that holds them.
    """

    triangles: _core.TriangleTable
    embree: EmbreeScene
    mesh: TriangleMesh
    centre_m: NDArray[np.float64]
    pose: Callable[[float], FramePose]
    first_face: int
    edges: _core.EdgeTable
    radius_m: float

    def middle_m(self, map_T_object: FramePose) -> NDArray[np.float64]:  # noqa: N803
        """Of the ball that holds the triangles, map frame, (3,)."""
        away_m: NDArray[np.float64] = map_T_object.rotation @ self.centre_m
        return map_T_object.position_m + away_m

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
        standing: number of the group that stands still, or `NOTHING`.
        moving: whether any surface moves.
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
        self.standing, self.moving = (0 if still else NOTHING), bool(moving)
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
        reach_m: float,
        threads: int = 2,
        *,
        near_m: NDArray[np.float32] | None = None,
    ) -> Hits:
        """What rays meet first.

        Args:
            origin_m: map frame, (3,) or, much slower, (N, 3).
            direction: unit vectors, map frame, (N, 3).
            time_s: at which moving objects are met.
            reach_m: maximum range of a hit.
            threads: that share the rays.
            near_m: minimum range, (N,); only for rays of one origin.

        Raises:
            ValueError: `near_m` is given for rays of several origins.
        """
        if origin_m.ndim == 1:
            met = Hits.empty(len(direction), reach_m)
            self._cast_bundle(met, origin_m, direction, time_s, near_m=near_m, threads=threads)
            met.range_m[met.face < 0] = np.inf
            return met
        if near_m is not None:
            raise ValueError("near_m needs rays of one origin: origin_m must be (3,)")
        count = len(direction)
        parts = min(threads, max(1, count // MIN_RAYS_PER_THREAD))
        cuts = [slice(count * i // parts, count * (i + 1) // parts) for i in range(parts)]

        def work(part: slice) -> Hits:
            met = Hits.empty(part.stop - part.start, reach_m)
            self._cast_each(met, origin_m[part], direction[part], time_s, reach_m)
            met.range_m[met.face < 0] = np.inf
            return met

        if parts == 1:
            return work(cuts[0])
        with ThreadPoolExecutor(parts) as pool:
            met_by_part = list(pool.map(work, cuts))
        return Hits(
            np.concatenate([met.range_m for met in met_by_part]),
            np.concatenate([met.face for met in met_by_part]),
            np.concatenate([met.group for met in met_by_part]),
        )

    def _cast_bundle(
        self,
        met: Hits,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        time_s: float,
        *,
        near_m: NDArray[np.float32] | None,
        threads: int,
    ) -> None:
        """Enter what rays of one origin meet first; `met` is empty."""
        reach_m = float(met.range_m.max(initial=0.0))
        for number, group in enumerate(self.groups):
            pose = group.pose(time_s)
            away_m = float(np.linalg.norm(group.middle_m(pose) - origin_m))
            if away_m > group.radius_m + reach_m:
                continue
            start, local = _in_frame(group, pose, origin_m[None, :], direction)
            group.triangles.cast_bundle(
                start[0], local, near_m, group.first_face, met.range_m, met.face, threads
            )
            if number > 0:  # 0 is the group of empty hits
                met.group[met.face >= group.first_face] = number
        if self._sea:
            sea_face, depth_m = len(self.planes) - 1, -float(origin_m[2])
            found = met.range_m, met.face, met.group
            _core.meet_sea(direction, depth_m, near_m, sea_face, self.sea_group, *found)

    def _cast_each(
        self,
        met: Hits,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        time_s: float,
        reach_m: float,
    ) -> None:
        """Enter what rays meet, each from an origin of its own."""
        for number, group in enumerate(self.groups):
            pose = group.pose(time_s)
            ray = _core.rays_near_ball(
                origin_m, direction, reach_m, group.middle_m(pose), group.radius_m
            )
            if len(ray) == 0:
                continue
            own = origin_m.take(ray, axis=0), direction.take(ray, axis=0)
            start, local = _in_frame(group, pose, *own)
            found = group.embree.run(start.astype(np.float32), local, output=True)
            nearer = (found["primID"] >= 0) & (found["tfar"] < met.range_m[ray])
            its = ray[nearer]
            met.range_m[its] = found["tfar"][nearer]
            met.face[its] = found["primID"][nearer] + group.first_face
            met.group[its] = number
        if self._sea:
            self._meet_sea_each(met, origin_m, direction)

    def _meet_sea_each(
        self, met: Hits, origin_m: NDArray[np.float64], direction: NDArray[np.float32]
    ) -> None:
        """The sea's surface is the plane z = 0, met from below."""
        rising = np.flatnonzero(direction[:, 2] > 0.0)
        height_m = -origin_m[rising, 2]
        steepness = np.maximum(direction[:, 2].take(rising), np.float32(1e-9))
        range_m = (height_m / steepness).astype(np.float32)
        its = np.flatnonzero((height_m > 0.0) & (range_m < met.range_m.take(rising)))
        met.range_m[rising[its]] = range_m[its]
        met.face[rising[its]] = len(self.planes) - 1
        met.group[rising[its]] = self.sea_group


def _in_frame(
    group: FrameGroup,
    map_T_object: FramePose,  # noqa: N803
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Origins and directions of rays of the map in a group's frame, about its centre, (N, 3)."""
    turn = map_T_object.rotation
    start = origin_m - map_T_object.position_m
    if not np.array_equal(turn, np.eye(3)):
        start = chunked_matmul(start, turn)
        direction = _core.rotated(direction, turn.astype(np.float32))
    return start - group.centre_m, np.ascontiguousarray(direction)


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
        table = _core.TriangleTable(corners)
        return FrameGroup(table, embree, mesh, centre, self._pose, first_face, edges, radius)


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
