"""Refraction: rays that bend where the speed of sound changes with depth.

The kernels take a refracted path as a straight one from a virtual sonar. Its distance from the hit
follows from the travel time, its direction is that of arrival, and it is turned so that the ray
leaves in the original direction.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.propagation.clouds import cloud_gain
from sonar_sim.propagation.physics import SoundSpeedProfile
from sonar_sim.propagation.propagation_path import LEG_SIZE, PingGeometry
from sonar_sim.raycast.fan import RayFan
from sonar_sim.raycast.meshes import NOTHING, Hits
from sonar_sim.raycast.tracing import MAX_HIDDEN_HITS, Trace, edges_of, refined_fan, spans

SEGMENTS = (2, 16)
"""Straight pieces of a bent ray: as few as keep each within `SAGITTA_M` of its arc."""
SAGITTA_M = 1e-3
STEEP = 1e-6
"""A chord with a smaller level part is vertical."""
TARGET_SEGMENTS = 64
"""Straight pieces of a path to a point target."""
MAX_LAUNCH_RAD = 0.7
"""A path leaves no farther off the chord than this; on a longer detour it would not be heard."""
LAUNCHES = 65
STRETCH = (0.25, 4.0)
"""Limits of what bending does to a ray's cell. Beyond is a caustic or a shadow: no ray tells."""
TOUCHING = 1e-6
"""Sines between the edges of two cells that lie one upon the other."""
REFINEMENTS = 4
"""Each time the bracket of a path's direction becomes `LAUNCHES` - 1 times as narrow."""


def refracted_paths(
    here: PingGeometry, layers: SoundSpeedProfile, fan: RayFan, reach_m: float, speed_mps: float
) -> tuple[Trace, list[_core.Rays]]:
    """Trace bent rays and make their ways; the sonar is taken to stand still.

    Args:
        here: the ping.
        layers: speeds of sound.
        fan: rays, sonar frame.
        reach_m: where they end, along the way.
        speed_mps: that turns time into range.

    Returns:
        The rays, with ranges by time along the directions in which they left; and the ways.
    """
    start, found = _trace_refracted(here, layers, fan.directions, reach_m, speed_mps)
    met = found[0].met
    edges = edges_of(here.meshes, fan, start.astype(np.float32), met)
    fan, source = refined_fan(
        here.meshes,
        fan,
        met,
        edges,
        viewpoints=(here.pose,),
        time_s=here.time_s,
        reach_m=reach_m,
        layers=_table(layers),
    )
    new = source < 0
    if new.any():
        more_start, more = _trace_refracted(here, layers, fan.directions[new], reach_m, speed_mps)
        start = _core.merged(start, source, more_start)
        found = [a.with_more(source, b) for a, b in zip(found, more, strict=True)]
    mets = tuple(layer.met for layer in found)
    trace = Trace(fan, start.astype(np.float32), here.pose.position_m, mets)
    return trace, [_ways(here, fan, start, layer) for layer in found]


def _trace_refracted(
    here: PingGeometry,
    layers: SoundSpeedProfile,
    directions: NDArray[np.float32],
    reach_m: float,
    speed_mps: float,
) -> tuple[NDArray[np.float64], list["_RefractedHits"]]:
    """Directions in which rays leave, map frame, (N, 3), and what they meet, first and behind."""
    start = directions.astype(np.float64) @ here.pose.rotation.T
    found = [
        _RefractedHits.nothing(start)
        for _ in range(1 if here.physics.shadows else 1 + MAX_HIDDEN_HITS)
    ]
    # Without shadows, each piece shows one layer of what lies behind.
    segments = _segments(layers, reach_m) if here.physics.shadows else SEGMENTS[1]
    step_m = reach_m / segments
    # Rays that are still on their way.
    ray = np.arange(len(start))
    point = np.broadcast_to(here.pose.position_m, start.shape).copy()
    direction, passed_m = start.copy(), np.zeros(len(start))
    for segment in range(segments):
        # Half a turn first: then each piece has the mean direction of its part of the arc.
        turn_m = step_m if segment else 0.5 * step_m
        speed, direction = _core.turned_rays(
            _table(layers), point, direction, step_m, turn_m, here.threads
        )
        # From the sonar, and not from points of its own, rays leave the face that it may lie in.
        start_m = point if segment else here.pose.position_m
        met = here.meshes.cast(
            start_m, direction.astype(np.float32), here.time_s, step_m, here.threads
        )
        new = np.flatnonzero(met.face >= 0)
        for layer in found:
            own = new[layer.face[ray[new]] == NOTHING]
            way_m, its = met.range_m[own].astype(np.float64), ray[own]
            layer.face[its], layer.group[its] = met.face[own], met.group[own]
            layer.arrival[its] = direction[own]
            layer.place_m[its] = point[own] + way_m[:, None] * direction[own]
            layer.range_m[its] = passed_m[own] + way_m * speed_mps / speed[own]
            new = np.setdiff1d(new, own, assume_unique=True)
        going = np.flatnonzero(found[-1].face[ray] == NOTHING)
        # By indices: a mask takes three times as long.
        ray, direction = ray.take(going), direction.take(going, axis=0)
        point = point.take(going, axis=0) + step_m * direction
        passed_m = passed_m.take(going) + step_m * speed_mps / speed.take(going)
    return start, found


def _segments(layers: SoundSpeedProfile, reach_m: float) -> int:
    """Pieces of a ray: over a length L, an arc of curvature k leaves its chord by k L² / 8."""
    depth_m, speed_mps = np.asarray(layers.depth_m), np.asarray(layers.speed_mps)
    slope = np.abs(np.diff(speed_mps) / np.maximum(np.diff(depth_m), 1e-9))
    curvature = float(slope.max(initial=0.0) / speed_mps.min())
    wanted = math.ceil(reach_m * math.sqrt(curvature / (8.0 * SAGITTA_M)))
    return min(max(wanted, SEGMENTS[0]), SEGMENTS[1])


@dataclass(frozen=True, slots=True, eq=False)
class EigenRay:
    """A bent path from the sonar to a point.

    Attributes:
        direction: in which it leaves and its echo arrives, unit vector, map frame, (3,).
        range_m: its travel time, as a range at the speed that turns time into range.
        corner_m: ends of its straight pieces, map frame, (`TARGET_SEGMENTS` + 1, 3).
    """

    direction: NDArray[np.float64]
    range_m: float
    corner_m: NDArray[np.float64]


def eigenrays(
    layers: SoundSpeedProfile,
    from_m: NDArray[np.float64],
    to_m: NDArray[np.float64],
    speed_mps: float,
) -> list[EigenRay]:
    """All paths between two points; none in a shadow zone, several where rays cross.

    Speeds change with depth alone, so paths stay in the points' vertical plane: rays are launched
    about the chord, and those between which the point lies are brought together.

    Args:
        layers: speeds of sound.
        from_m: the sonar, map frame, (3,).
        to_m: the other point, map frame, (3,).
        speed_mps: that turns time into range.
    """
    chord_m = float(np.linalg.norm(to_m - from_m))
    ahead = (to_m - from_m) / max(chord_m, 1e-9)
    up = np.array([0.0, 0.0, 1.0]) - ahead[2] * ahead
    if np.linalg.norm(up) < STEEP:
        up = np.array([1.0, 0.0, 0.0])
    plane = np.stack([ahead, up / np.linalg.norm(up)])
    rays = []
    angle = np.linspace(-MAX_LAUNCH_RAD, MAX_LAUNCH_RAD, LAUNCHES)
    know = {"chord_m": chord_m, "speed_mps": speed_mps}
    miss = _launched(layers, from_m, plane, angle, **know)[0]
    for below in np.flatnonzero((miss[:-1] <= 0.0) != (miss[1:] <= 0.0)):
        low, high = angle[below], angle[below + 1]
        if not np.isfinite(miss[below : below + 2]).all():
            continue
        for _ in range(REFINEMENTS):
            between = np.linspace(low, high, LAUNCHES)
            off, range_m, corner_m = _launched(layers, from_m, plane, between, **know)
            change = np.flatnonzero((off[:-1] <= 0.0) != (off[1:] <= 0.0))
            if len(change):
                first = int(change[0])
            else:  # rounding moved a root out that lies at an end, as of a straight path
                first = 0 if abs(off[0]) <= abs(off[-1]) else LAUNCHES - 2
            low, high = between[first], between[first + 1]
            best = first + int(np.argmin(np.abs(off[first : first + 2])))
        leaving = np.cos(between[best]) * plane[0] + np.sin(between[best]) * plane[1]
        rays.append(EigenRay(leaving, float(range_m[best]), corner_m[:, best]))
    return rays


def _launched(
    layers: SoundSpeedProfile,
    from_m: NDArray[np.float64],
    plane: NDArray[np.float64],
    angle_rad: NDArray[np.float64],
    *,
    chord_m: float,
    speed_mps: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """By how much rays pass over the chord's end, by what range, and where they go.

    Args:
        layers: speeds of sound.
        from_m: where they start, map frame, (3,).
        plane: unit vectors of the chord and of what is up across it, (2, 3).
        angle_rad: of the launches over the chord, (N,).
        chord_m: its length.
        speed_mps: that turns time into range.

    Returns:
        Misses (N,), NaN for rays that turn back; ranges by time (N,); corners
        (`TARGET_SEGMENTS` + 1, N, 3), which end where the rays pass the point.
    """
    direction = np.outer(np.cos(angle_rad), plane[0]) + np.outer(np.sin(angle_rad), plane[1])
    # Each ray gets as far along the chord as a straight one would with a little to spare.
    step_m = 1.1 * chord_m / TARGET_SEGMENTS / float(np.cos(angle_rad).min())
    corner_m, range_m = _core.followed_rays(
        _table(layers), from_m, direction, step_m, TARGET_SEGMENTS, speed_mps
    )
    along_m = (corner_m - from_m) @ plane[0]
    passed = along_m >= chord_m
    last = np.maximum(passed.argmax(axis=0), 1)
    each = np.arange(len(angle_rad))
    before, after = along_m[last - 1, each], along_m[last, each]
    part = (chord_m - before) / np.maximum(after - before, 1e-12)
    end_m = corner_m[last - 1, each] + part[:, None] * (
        corner_m[last, each] - corner_m[last - 1, each]
    )
    end_range_m = range_m[last - 1, each]
    end_range_m = end_range_m + part * (range_m[last, each] - end_range_m)
    beyond = np.arange(TARGET_SEGMENTS + 1)[:, None] >= last
    corner_m = np.where(beyond[:, :, None], end_m, corner_m)
    miss_m = np.where(passed.any(axis=0), (end_m - from_m) @ plane[1], np.nan)
    return miss_m, end_range_m, corner_m


@dataclass(frozen=True, slots=True, eq=False)
class _RefractedHits:
    """What each bent ray met first, or next, (N,) and (N, 3); filled segment by segment."""

    range_m: NDArray[np.float64]
    face: NDArray[np.int32]
    group: NDArray[np.int32]
    arrival: NDArray[np.float64]
    place_m: NDArray[np.float64]

    @classmethod
    def nothing(cls, start: NDArray[np.float64]) -> "_RefractedHits":
        count = len(start)
        face = np.full(count, NOTHING, dtype=np.int32)
        group = np.zeros(count, dtype=np.int32)
        return cls(np.full(count, np.inf), face, group, start.copy(), np.zeros_like(start))

    def with_more(self, source: NDArray[np.int32], more: "_RefractedHits") -> "_RefractedHits":
        """Of a finer fan's rays; see `_core.merged`."""
        return _RefractedHits(
            _core.merged(self.range_m, source, more.range_m),
            _core.merged(self.face, source, more.face),
            _core.merged(self.group, source, more.group),
            _core.merged(self.arrival, source, more.arrival),
            _core.merged(self.place_m, source, more.place_m),
        )

    @property
    def met(self) -> Hits:
        return Hits(self.range_m.astype(np.float32), self.face, self.group)


def _ways(
    here: PingGeometry, fan: RayFan, start: NDArray[np.float64], found: _RefractedHits
) -> _core.Rays:
    """The sound's ways to what was met and back."""
    hit = np.flatnonzero(here.echoes(found.face))
    legs = _virtual_legs(
        here,
        found.group[hit],
        start=start[hit],
        arrival=found.arrival[hit],
        place_m=found.place_m[hit],
        range_m=found.range_m[hit],
    )
    gain = np.ones(len(hit), dtype=np.float32)
    if here.physics.clouds:
        # Clouds are not so large that the arc leaves its chord within one.
        origin_m, place_m = here.pose.position_m, found.place_m[hit]
        chord_m = np.linalg.norm(place_m - origin_m, axis=1)
        way = ((place_m - origin_m) / np.maximum(chord_m, 1e-9)[:, None]).astype(np.float32)
        gain = cloud_gain(here.physics.clouds, origin_m, way, chord_m)
    own = np.arange(len(hit), dtype=np.int32)
    cell, lean = _stretched(here, fan, start, found)
    return _core.Rays(
        face=found.face[hit],
        seen=own,
        transmit=own,
        receive=own,
        cell=cell[hit],
        span_m=spans(here.meshes, fan, found.met)[hit],
        gain=gain,
        legs=legs,
        lean=None if lean is None else lean[hit],
    )


def _stretched(
    here: PingGeometry, fan: RayFan, start: NDArray[np.float64], found: _RefractedHits
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Cells that cover what bent rays stand for, (N, 4), and how they lean, (N, 2).

    Bending spreads neighbours or gathers them. A ray's virtual leg sees the place of its neighbour
    in the column so many times farther off than the neighbour left: so much higher is its cell, and
    patches neither leave gaps nor overlap. Spreading still goes by the travel time.
    """
    touching = np.abs(fan.cell[1:, 2] - fan.cell[:-1, 3]) < TOUCHING
    lower = np.flatnonzero((fan.column[1:] == fan.column[:-1]) & touching)
    lower = lower[(found.face[lower] >= 0) & (found.face[lower + 1] >= 0)]
    parted = edges_of(here.meshes, fan, start.astype(np.float32), found.met)
    lower = lower[~np.isin(lower, parted)]
    cell, w = fan.cell.copy(), fan.directions[:, 2].astype(np.float64)
    for ray, other, edge in ((lower, lower + 1, 3), (lower + 1, lower, 2)):
        up = _rotations(start[ray], found.arrival[ray]) @ here.pose.rotation[:, 2]
        origin_m = found.place_m[ray] - found.range_m[ray, None] * found.arrival[ray]
        way = found.place_m[other] - origin_m
        seen = np.einsum("nj,nj->n", way, up) / np.linalg.norm(way, axis=1)
        times = np.clip((seen - w[ray]) / (w[other] - w[ray]), *STRETCH)
        cell[ray, edge] = w[ray] + times * (fan.cell[ray, edge] - w[ray])
    if fan.lean is None:
        return cell, None
    higher = (cell[:, 3] - cell[:, 2]) / (fan.cell[:, 3] - fan.cell[:, 2])
    return cell, fan.lean * np.stack([1.0 / higher, higher], axis=1).astype(np.float32)


def _table(layers: SoundSpeedProfile) -> NDArray[np.float64]:
    """Depths and speeds as the kernels take them, (L, 2)."""
    return np.stack([layers.depth_m, layers.speed_mps], axis=1).astype(np.float64)


def _virtual_legs(
    here: PingGeometry,
    group: NDArray[np.int32],
    *,
    start: NDArray[np.float64],
    arrival: NDArray[np.float64],
    place_m: NDArray[np.float64],
    range_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """One leg a hit, in the frame of what was met, (H, 16)."""
    turn = _rotations(start, arrival)
    origin = place_m - range_m[:, None] * arrival
    legs = np.zeros((len(group), LEG_SIZE))
    legs[:, 15] = 1.0
    for number, frame in enumerate(here.meshes.poses(here.time_s)):
        own = np.flatnonzero(group == number)
        back = frame.rotation.T
        legs[own, :3] = (origin[own] - frame.position_m) @ frame.rotation
        legs[own, 3:12] = _matmul(back, turn[own], here.pose.rotation)
    return legs


def _matmul(
    left: NDArray[np.float64], middle: NDArray[np.float64], right: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Products `left @ middle[n] @ right`, row by row, (N, 9), of a stack (N, 3, 3)."""
    # As one product of vectors of nine: a stack of small matrices is multiplied one by one.
    both = np.kron(left, right.T).T.astype(np.float64)
    return chunked_matmul(middle.reshape(-1, 9), both)


def _rotations(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """The smallest rotations that turn unit vectors into others, (N, 3, 3) (Rodrigues)."""
    axis = np.cross(start, end)
    cosine = np.einsum("ij,ij->i", start, end)
    rotation: NDArray[np.float64] = axis[:, :, None] * axis[:, None, :]
    rotation /= (1.0 + cosine)[:, None, None]
    for k in range(3):
        rotation[:, k, k] += cosine
        rotation[:, (k + 2) % 3, (k + 1) % 3] += axis[:, k]
        rotation[:, (k + 1) % 3, (k + 2) % 3] -= axis[:, k]
    return rotation
