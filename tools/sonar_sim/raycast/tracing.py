"""Trace a ping's rays: what each direction hits, with edges of objects traced finer.

How far a face's plane stands for the surface about a hit.

A ray's cell may reach far beyond the face that it met: over a floor of small triangles at grazing
incidence it has to, around a ball it must not. What the neighbouring rays met on the same surface
distinguishes the two.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.geometry.pose import FramePose
from sonar_sim.raycast.fan import RayFan, refined_fan
from sonar_sim.raycast.meshes import NOTHING, Hits, Meshes

Number = TypeVar("Number", np.float32, np.int32)

MAX_SLOPE = 0.15
"""Neighbours met one surface if neither leaves the other's plane by more than this slope."""
MIN_STEP_M = 0.02
MIN_COSINE = 0.995
"""Neighbours on a round surface stand for each other up to this cosine between their normals: a
mirror's glint on it is found by its normals."""
FINER_SHARE = 16
"""At most one in so many pairs of neighbours is traced finer: those farthest apart in range."""
BEHIND = 3
"""Surfaces seen behind the first where nothing casts a shadow."""
PAST_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Rays from one pose.

    Attributes:
        fan: of the rays, finer ones among them, column after column.
        direction: in the map frame, (N, 3).
        origin_m: map frame, (3,).
        met: what each met first; further entries lie behind where shadows are off.
    """

    fan: RayFan
    direction: NDArray[np.float32]
    origin_m: NDArray[np.float64]
    met: tuple[Hits, ...]


def trace(
    meshes: Meshes,
    fan: RayFan,
    map_T_sonar: FramePose,  # noqa: N803
    time_s: float,
    reach_m: float,
    *,
    shadows: bool = True,
    threads: int = 2,
) -> Trace:
    """Cast a fan from a pose.

    Args:
        meshes: what can be met.
        fan: of rays, in the sonar's frame.
        map_T_sonar: the sonar.
        time_s: at which moving objects are met.
        reach_m: what lies farther is not met.
        shadows: whether only the first thing on a ray is met.
        threads: that share the rays.
    """
    origin = map_T_sonar.position_m
    turn = map_T_sonar.rotation.T.astype(np.float32)
    direction = chunked_matmul(fan.directions, turn)
    met = meshes.cast(origin, direction, time_s, reach_m, threads)
    edges = edges_of(meshes, fan, direction, met)
    if len(edges):
        more = refined_fan(fan, edges)
        more_direction = chunked_matmul(more.directions, turn)
        more_met = meshes.cast(origin, more_direction, time_s, reach_m, threads)
        fan, direction, met = _joined(
            fan, edges, direction, met, more=more, more_direction=more_direction, more_met=more_met
        )
    layers = [met]
    if not shadows:
        layers += _behind(
            meshes, origin, direction, met, time_s=time_s, reach_m=reach_m, threads=threads
        )
    return Trace(fan, direction, origin, tuple(layers))


def edges_of(
    meshes: Meshes, fan: RayFan, direction: NDArray[np.float32], met: Hits
) -> NDArray[np.int64]:
    """Rays whose upper neighbour in the column met something else."""
    edges = _core.edges(
        direction,
        met.range_m,
        met.face,
        met.group,
        fan.column,
        meshes.normals,
        meshes.smooth,
        MAX_SLOPE,
        MIN_STEP_M,
        MIN_COSINE,
    )
    most = len(direction) // FINER_SHARE
    if len(edges) > most:
        reach = np.where(met.face >= 0, met.range_m, np.float32(1e6))
        jump = np.abs(reach[edges + 1] - reach[edges])
        edges = np.sort(edges[np.argsort(-jump, kind="stable")[:most]])
    return edges


def _joined(
    fan: RayFan,
    edges: NDArray[np.int64],
    direction: NDArray[np.float32],
    met: Hits,
    *,
    more: RayFan,
    more_direction: NDArray[np.float32],
    more_met: Hits,
) -> tuple[RayFan, NDArray[np.float32], Hits]:
    """Both fans and what they met in one."""

    def both(coarse: NDArray[Number], fine: NDArray[Number]) -> NDArray[Number]:
        return _core.inserted(coarse, edges, fine)

    all_met = Hits(
        both(met.range_m, more_met.range_m),
        both(met.face, more_met.face),
        both(met.group, more_met.group),
    )
    return joined_fan(fan, edges, more), both(direction, more_direction), all_met


def joined_fan(fan: RayFan, edges: NDArray[np.int64], more: RayFan) -> RayFan:
    """Both fans in one; the coarse cells give way to the finer ones."""
    cell = fan.cell.copy()
    cell[edges, 3] = fan.directions[edges, 2]
    cell[edges + 1, 2] = fan.directions[edges + 1, 2]
    return RayFan(
        _core.inserted(fan.directions, edges, more.directions),
        _core.inserted(cell, edges, more.cell),
        _core.inserted(fan.column, edges, more.column),
        fan.columns,
        fan.sine_pitch,
    )


def _behind(
    meshes: Meshes,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
    first: Hits,
    *,
    time_s: float,
    reach_m: float,
    threads: int,
) -> list[Hits]:
    """What the rays meet behind what they met."""
    layers: list[Hits] = []
    past = np.where(first.face >= 0, first.range_m + np.float32(PAST_M), np.float32(0.0))
    open_way = first.face >= 0
    for _ in range(BEHIND):
        start = origin_m + direction.astype(np.float64) * past[:, None]
        met = meshes.cast(start, direction, time_s, reach_m, threads)
        range_m = (met.range_m + past).astype(np.float32)
        face = np.where(open_way & (range_m < reach_m), met.face, NOTHING).astype(np.int32)
        layers.append(Hits(range_m, face, met.group))
        open_way = face >= 0
        past = np.where(open_way, range_m + np.float32(PAST_M), past).astype(np.float32)
    return layers


def spans(meshes: Meshes, fan: RayFan, met: Hits) -> NDArray[np.float32]:
    """Ranges between which each hit's plane is followed, (N, 2)."""
    up = np.ascontiguousarray(fan.directions[:, 2])
    return _core.spans(met.range_m, met.face, fan.column, up, meshes.surface, meshes.size_m)


def span_about(
    meshes: Meshes, met: Hits, low_m: NDArray[np.float32], high_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Widened by the face's own size, (N, 2)."""
    size = meshes.size_m[met.face]
    range_m = np.where(met.face >= 0, met.range_m, np.float32(0.0))
    near = np.maximum(np.minimum(low_m, range_m - size), np.float32(0.0))
    return np.stack([near, np.maximum(high_m, range_m + size)], axis=1).astype(np.float32)
