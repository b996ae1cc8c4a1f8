"""Trace a ping's rays: what each direction hits, with outlines of objects traced exactly.

A ray stands for a cell of directions. Where the outline of a mesh crosses a cell, as its edges
tell, the cell is cut along it, and each part gets a ray of its own: no object is too thin to be
met. Where surfaces pass into each other without an outline, rays are laid between neighbours that
met different ones.

`spans` gives the ranges between which a hit's plane stands for its surface. A cell may reach far
beyond the face that its ray hit: on a floor of small triangles at grazing incidence it must, on a
ball it must not. Hits of neighbouring rays on the same surface tell the two apart.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.pose import FramePose
from sonar_sim.raycast.fan import RayFan
from sonar_sim.raycast.meshes import Hits, Meshes

MAX_SLOPE = 0.15
"""Neighbours met one surface if neither leaves the other's plane by more than this slope."""
MIN_STEP_M = 0.02
MIN_COSINE = 0.995
"""Neighbours on a round surface stand for each other up to this cosine between their normals: a
mirror's glint on it is found by its normals."""
MAX_HIDDEN_HITS = 3
"""Further hits followed behind the first one if shadows are off."""
PAST_M = 1e-3
MAX_GAP = 1e-6
"""Of sines of elevation, between cells that touch."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Rays from one pose.

    Attributes:
        fan: of the rays, finer ones among them, column after column.
        direction: in the map frame, (N, 3).
        origin_m: map frame, (3,).
        met: what each met first; further entries lie behind where shadows are off.
        coarse: what the fan's rays met before it was refined; None where rays are bent.
    """

    fan: RayFan
    direction: NDArray[np.float32]
    origin_m: NDArray[np.float64]
    met: tuple[Hits, ...]
    coarse: Hits | None = None


def trace(
    meshes: Meshes,
    fan: RayFan,
    map_T_sonar: FramePose,  # noqa: N803
    time_s: float,
    reach_m: float,
    *,
    shadows: bool = True,
    threads: int = 2,
    cast: Callable[[NDArray[np.float32]], Hits] | None = None,
    first_cast: Callable[[NDArray[np.float32]], Hits] | None = None,
    real_sonar: FramePose | None = None,
) -> Trace:
    """Cast a fan from a pose.

    Args:
        meshes: what can be met.
        fan: of rays, in the sonar's frame.
        map_T_sonar: the sonar.
        time_s: at which moving objects are met.
        reach_m: maximum range of a hit.
        shadows: whether only the first thing on a ray is met.
        threads: that share the rays.
        cast: what directions of the map frame, (N, 3), meet; by default the nearest mesh.
        first_cast: the same for the fan's own rays alone, if some of it is known.
        real_sonar: pose of the real sonar if `map_T_sonar` is its mirror image; outlines seen from
            it, such as the mirror's own, also cut cells.
    """
    origin = map_T_sonar.position_m
    turn = map_T_sonar.rotation.T.astype(np.float32)
    if cast is None:

        def cast(direction: NDArray[np.float32]) -> Hits:
            return meshes.cast(origin, direction, time_s, reach_m, threads)

    direction = _core.rotated(fan.directions, turn)
    met = coarse = cast(direction) if first_cast is None else first_cast(direction)
    edges = edges_of(meshes, fan, direction, met)
    # Where a part of the fan is left out, the next ray may be farther up.
    edges = edges[np.abs(fan.cell[edges, 3] - fan.cell[edges + 1, 2]) < MAX_GAP]
    viewpoints = (map_T_sonar,) if real_sonar is None else (map_T_sonar, real_sonar)
    fan, source = refined_fan(
        meshes, fan, met, edges, viewpoints=viewpoints, time_s=time_s, reach_m=reach_m
    )
    new = np.flatnonzero(source < 0)
    if len(new):
        new_direction = _core.rotated(fan.directions.take(new, axis=0), turn)
        direction = _core.merged(direction, source, new_direction)
        more = cast(new_direction)
        met = Hits(
            _core.merged(met.range_m, source, more.range_m),
            _core.merged(met.face, source, more.face),
            _core.merged(met.group, source, more.group),
        )
    layers = [met]
    if not shadows:
        layers += _behind(
            meshes, origin, direction, met, time_s=time_s, reach_m=reach_m, threads=threads
        )
    return Trace(fan, direction, origin, tuple(layers), coarse)


def edges_of(
    meshes: Meshes, fan: RayFan, direction: NDArray[np.float32], met: Hits
) -> NDArray[np.int64]:
    """Rays whose upper neighbour in the column met something else."""
    return _core.edges(
        direction,
        met.range_m,
        met.face,
        met.group,
        meshes.standing,
        fan.column,
        meshes.normals,
        meshes.smooth,
        MAX_SLOPE,
        MIN_STEP_M,
        MIN_COSINE,
    )


def refined_fan(
    meshes: Meshes,
    fan: RayFan,
    met: Hits,
    edges: NDArray[np.int64],
    *,
    viewpoints: tuple[FramePose, ...],
    time_s: float,
    reach_m: float,
    layers: NDArray[np.float64] | None = None,
) -> tuple[RayFan, NDArray[np.int32]]:
    """The fan with its cells cut along the outlines of what it sees.

    Args:
        meshes: what can be met.
        fan: that was cast.
        met: by its rays.
        edges: rays whose upper neighbour met something else.
        viewpoints: poses of the sonar, and of its image, from which outlines are seen.
        time_s: at which moving objects are met.
        reach_m: maximum range of an outline.
        layers: depths and speeds of sound that bend the rays, (L, 2).

    Returns:
        The finer fan, and the ray of the other that each of its rays is; -1 for those to be cast.
    """
    directions, cell, lean, column, source = _core.refined_rays(
        fan.directions,
        fan.cell,
        met.range_m,
        fan.grid.row_edges,
        fan.grid.rays,
        fan.first_sine - fan.sine_pitch / 2.0,
        fan.sine_pitch,
        [group.seen_from(eye, time_s) for eye in viewpoints for group in meshes.groups],
        edges,
        reach_m,
        np.empty((0, 2)) if layers is None else layers,
        np.append(viewpoints[0].rotation[2], viewpoints[0].position_m[2]),
    )
    fine = RayFan(directions, cell, column, fan.columns, fan.sine_pitch, fan.grid, lean)
    return fine, source


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
    past = first.range_m + np.float32(PAST_M)
    for _ in range(MAX_HIDDEN_HITS):
        met = meshes.cast(origin_m, direction, time_s, reach_m, threads, near_m=past)
        layers.append(met)
        past = met.range_m + np.float32(PAST_M)
    return layers


def spans(meshes: Meshes, fan: RayFan, met: Hits) -> NDArray[np.float32]:
    """Ranges between which each hit's plane is followed, (N, 2)."""
    up = np.ascontiguousarray(fan.directions[:, 2])
    return _core.spans(met.range_m, met.face, fan.column, up, meshes.surface, meshes.size_m)
