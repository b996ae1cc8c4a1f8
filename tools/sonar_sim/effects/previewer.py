"""Preview a ping: the coarse cast that the rules evaluate."""

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.echoes import (
    COLUMNS,
    NO_SURFACE,
    SKIP_M,
    CoarseFan,
    Echoes,
    coarse_echoes,
    coarse_fan,
    within_range,
)
from sonar_sim.effects.planes import mirror_planes
from sonar_sim.effects.preview import PingPreview, SolidObjects
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.raycast.meshes import Hits, Meshes
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

LEVEL = 0.7
"""A floor's mean |vertical part of the normal|, at least."""
HIDDEN_RAY_STRIDE = 3
"""Every n-th ray is followed behind its hit: hidden objects are wide, or barely hidden."""
LARGE = 0.1
"""Of the sonar's range: longer edges make a face large."""
FOOT_M = 0.5
"""How far above the scene's lowest point a floor's lowest point may lie."""


class Previewer:
    """A scene and a sonar, to preview pings from any pose."""

    def __init__(self, scene: Scene, sonar: SonarSettings, meshes: Meshes | None = None) -> None:
        self._scene = scene
        self._sonar = sonar
        self._meshes = meshes or Meshes(scene)
        self._fan = coarse_fan(sonar)
        self._planes = mirror_planes(scene, sonar)
        self._bottoms = floor_surfaces(scene)
        self._solids = solids(scene, self._bottoms, sonar.range_m)

    @property
    def sonar(self) -> SonarSettings:
        """What looks."""
        return self._sonar

    @property
    def changes(self) -> bool:
        """Whether anything in the scene moves."""
        moving = [s.motion for s in self._scene.surfaces] + [t.motion for t in self._scene.targets]
        return any(motion is not None for motion in moving)

    def clear(self, from_m: NDArray[np.float64], to_m: NDArray[np.float64], time_s: float) -> bool:
        """Whether nothing stands between two points, map frame."""
        way_m = to_m - from_m
        length_m = float(np.linalg.norm(way_m))
        if length_m == 0.0:
            return True
        direction = (way_m / length_m).astype(np.float32).reshape(1, 3)
        return bool(self._meshes.cast(from_m, direction, time_s, length_m, threads=1).face[0] < 0)

    def at(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
        slack_m: float = 0.0,
    ) -> PingPreview:
        """Cast the coarse rays; once more from behind what they met if that is asked for.

        Args:
            map_T_sonar: from which the rays are cast.
            ping_id: of the ping.
            time_s: of the ping.
            motion: of the sonar in the ping.
            slack_m: how far the ping's own pose may be from this one. What lies so little out of
                range is taken to be in the last row.
        """
        turned = chunked_matmul(self._fan.directions, map_T_sonar.rotation.T).astype(np.float32)
        origin_m, reach_m = map_T_sonar.position_m, self._sonar.range_m + slack_m
        met = self._meshes.cast(origin_m, turned, time_s, reach_m, threads=1)

        def echoes_of(fan: CoarseFan, hits: Hits) -> Echoes:
            return coarse_echoes(
                self._scene,
                self._sonar,
                fan,
                self._meshes,
                hits,
                map_T_sonar=map_T_sonar,
                time_s=time_s,
                slack_m=slack_m,
            )

        def hidden() -> Echoes:
            some = slice(None, None, HIDDEN_RAY_STRIDE)
            past_m = np.minimum(met.range_m[some] + np.float32(SKIP_M), np.float32(reach_m))
            behind = self._meshes.cast(
                origin_m, turned[some], time_s, reach_m, threads=1, near_m=past_m
            )
            fan = replace(
                self._fan,
                directions=self._fan.directions[some],
                column=self._fan.column[some],
                up_step=HIDDEN_RAY_STRIDE * self._fan.up_step,
                solid_angle_sr=HIDDEN_RAY_STRIDE * self._fan.solid_angle_sr[some],
            )
            return echoes_of(fan, behind)

        points = self._points(map_T_sonar, time_s, reach_m)
        return PingPreview(
            scene=self._scene,
            sonar=self._sonar,
            map_T_sonar=map_T_sonar,
            motion=motion,
            time_s=time_s,
            ping_id=ping_id,
            meshes=self._meshes,
            planes=self._planes,
            bottoms=self._bottoms,
            solids=self._solids,
            fan=self._fan,
            end_m=met.range_m.astype(np.float64),
            echoes=_joined(echoes_of(self._fan, met), points),
            cast_hidden=hidden,
        )

    def _points(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        time_s: float,
        reach_m: float,
    ) -> Echoes:
        """The scene's point targets ahead and in range; what hides them is not asked."""
        targets = self._scene.targets
        point_m = np.array([t.position_at_m(time_s) for t in targets]).reshape(-1, 3)
        section_m2 = 10.0 ** (np.array([t.target_strength_db for t in targets]) / 10.0)
        away_m = (point_m - map_T_sonar.position_m) @ map_T_sonar.rotation
        range_m = np.maximum(np.linalg.norm(away_m, axis=1), 1e-6)
        direction = away_m / range_m[:, None]
        column = np.floor((-direction[:, 1] - self._fan.left_sine) / self._fan.sine_step)
        column = column.astype(np.int64)
        kept = (range_m < reach_m) & (direction[:, 0] > 0.0)
        kept &= (column >= 0) & (column < COLUMNS)
        none, one = np.zeros(int(kept.sum())), np.ones(int(kept.sum()))
        return Echoes(
            column=column[kept],
            direction=direction[kept],
            point_m=point_m[kept],
            normal=np.zeros((len(none), 3)),
            range_m=within_range(self._sonar, range_m[kept]),
            extent_m=none,
            surface=np.full(len(none), NO_SURFACE, dtype=np.int64),
            cos_incidence=one,
            lambert_m2=section_m2[kept],
            isotropic_m2=section_m2[kept],
            lobe_m2=none,
        )


def floor_surfaces(scene: Scene) -> frozenset[str]:
    """Names of the surfaces that are the floor: they lie level, and at the scene's foot."""
    solid = [s for s in scene.surfaces if s.motion is None and len(s.faces)]
    if not solid:
        return frozenset()
    foot_m = min(float(s.vertices_m[:, 2].min()) for s in solid)
    return frozenset(
        s.name
        for s in solid
        if s.vertices_m[:, 2].min() < foot_m + FOOT_M and _levelness(s) > LEVEL
    )


def solids(scene: Scene, floors: frozenset[str], range_m: float) -> SolidObjects:
    """All surfaces but the floors; faces are large from a part of the sonar's range on."""
    vertices, large, longest_m = [np.empty((0, 3))], [], 0.0
    for surface in scene.surfaces:
        if surface.name in floors or len(surface.faces) == 0:
            continue
        corners = surface.vertices_m[surface.faces]
        edge_m = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        if edge_m > LARGE * range_m:
            large.append([surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)])
        else:
            vertices.append(surface.vertices_m)
            longest_m = max(longest_m, float(edge_m))
    moving = any(surface.motion is not None for surface in scene.surfaces)
    boxes_m = np.array(large).reshape(-1, 2, 3)
    return SolidObjects(np.concatenate(vertices), longest_m / 2.0, boxes_m, moving)


def _levelness(surface: Surface) -> float:
    """Mean |vertical part of the normal| by area."""
    triangles = surface.vertices_m[surface.faces]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = float(np.linalg.norm(across, axis=1).sum())
    return float(np.abs(across[:, 2]).sum()) / area if area > 0.0 else 0.0


def _joined(first: Echoes, second: Echoes) -> Echoes:
    if len(second.range_m) == 0:
        return first
    names = (field.name for field in fields(Echoes))
    return Echoes(**{n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in names})
