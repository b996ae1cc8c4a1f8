"""Refraction: rays that bend where the speed of sound changes with depth.

The kernels take a refracted path as a straight one from a virtual sonar. Its distance from the hit
follows from the travel time, its direction is that of arrival, and it is turned so that the ray
leaves in the original direction.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.propagation.clouds import cloud_gain
from sonar_sim.propagation.physics import SoundSpeedProfile
from sonar_sim.propagation.propagation_path import LEG_SIZE, PingGeometry
from sonar_sim.raycast.fan import RayFan, refined_fan
from sonar_sim.raycast.meshes import NOTHING, Hits
from sonar_sim.raycast.tracing import BEHIND, Trace, edges_of, joined_fan, spans

Number = TypeVar("Number", np.float32, np.float64, np.int32)

SEGMENTS = 16
"""Straight pieces of a bent ray."""
STEEP = 1e-6


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
    start, found = _followed(here, layers, fan, reach_m, speed_mps)
    edges = edges_of(here.meshes, fan, start.astype(np.float32), found[0].met)
    if len(edges):
        more = refined_fan(fan, edges)
        fan = joined_fan(fan, edges, more)
        more_start, more_found = _followed(here, layers, more, reach_m, speed_mps)
        start = _core.inserted(start, edges, more_start)
        found = [a.with_more(edges, b) for a, b in zip(found, more_found, strict=True)]
    mets = tuple(layer.met for layer in found)
    trace = Trace(fan, start.astype(np.float32), here.pose.position_m, mets)
    return trace, [_ways(here, fan, start, layer) for layer in found]


def _followed(
    here: PingGeometry, layers: SoundSpeedProfile, fan: RayFan, reach_m: float, speed_mps: float
) -> tuple[NDArray[np.float64], list["_Found"]]:
    """Directions in which rays leave, map frame, (N, 3), and what they meet, first and behind."""
    start = fan.directions.astype(np.float64) @ here.pose.rotation.T
    point = np.broadcast_to(here.pose.position_m, start.shape).copy()
    direction, step_m = start.copy(), reach_m / SEGMENTS
    found = [_Found.nothing(start) for _ in range(1 if here.physics.shadows else 1 + BEHIND)]
    passed_m = np.zeros(len(start))
    for segment in range(SEGMENTS):
        speed, direction = _turned(layers, point, direction, step_m)
        # From the sonar, and not from points of its own, rays leave the face that it may lie in.
        start_m = point if segment else here.pose.position_m
        met = here.meshes.cast(
            start_m, direction.astype(np.float32), here.time_s, step_m, here.threads
        )
        new = np.flatnonzero(met.face >= 0)
        for layer in found:
            rays = new[layer.face[new] == NOTHING]
            way_m = met.range_m[rays].astype(np.float64)
            layer.face[rays], layer.group[rays] = met.face[rays], met.group[rays]
            layer.arrival[rays] = direction[rays]
            layer.place_m[rays] = point[rays] + way_m[:, None] * direction[rays]
            layer.range_m[rays] = passed_m[rays] + way_m * speed_mps / speed[rays]
            new = np.setdiff1d(new, rays, assume_unique=True)
        point += step_m * direction
        passed_m += step_m * speed_mps / speed
    return start, found


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What each bent ray met first, or next, (N,) and (N, 3); filled segment by segment."""

    range_m: NDArray[np.float64]
    face: NDArray[np.int32]
    group: NDArray[np.int32]
    arrival: NDArray[np.float64]
    place_m: NDArray[np.float64]

    @classmethod
    def nothing(cls, start: NDArray[np.float64]) -> "_Found":
        count = len(start)
        face = np.full(count, NOTHING, dtype=np.int32)
        group = np.zeros(count, dtype=np.int32)
        return cls(np.full(count, np.inf), face, group, start.copy(), np.zeros_like(start))

    def with_more(self, after: NDArray[np.int64], more: "_Found") -> "_Found":
        """With others between them, as many after each place."""

        def both(own: NDArray[Number], others: NDArray[Number]) -> NDArray[Number]:
            return _core.inserted(np.ascontiguousarray(own), after, np.ascontiguousarray(others))

        return _Found(
            both(self.range_m, more.range_m),
            both(self.face, more.face),
            both(self.group, more.group),
            both(self.arrival, more.arrival),
            both(self.place_m, more.place_m),
        )

    @property
    def met(self) -> Hits:
        return Hits(self.range_m.astype(np.float32), self.face, self.group)


def _ways(here: PingGeometry, fan: RayFan, start: NDArray[np.float64], found: _Found) -> _core.Rays:
    """The sound's ways to what was met and back."""
    hit = np.flatnonzero((found.face >= 0) & here.heard[found.face])
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
    return _core.Rays(
        face=found.face[hit],
        seen=own,
        transmit=own,
        receive=own,
        cell=fan.cell[hit],
        span_m=spans(here.meshes, fan, found.met)[hit],
        gain=gain,
        legs=legs,
    )


def _turned(
    layers: SoundSpeedProfile,
    point_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    step_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speed in the middle of the next segment and the segment's direction.

    A ray's angle of elevation changes by -(dc/dz) cos / c along the way (Snell); half of that
    before the segment, half after it, is a step of second order over all.
    """
    depth = -(point_m[:, 2] + 0.5 * step_m * direction[:, 2])
    speed = np.interp(depth, layers.depth_m, layers.speed_mps)
    before = np.interp(depth - STEEP, layers.depth_m, layers.speed_mps)
    after = np.interp(depth + STEEP, layers.depth_m, layers.speed_mps)
    upward_gradient = -(after - before) / (2.0 * STEEP)
    level = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-9)
    angle = np.arctan2(direction[:, 2], level) - upward_gradient * level / speed * step_m
    scale = np.cos(angle) / level
    turned = np.stack([direction[:, 0] * scale, direction[:, 1] * scale, np.sin(angle)], axis=1)
    return speed, turned


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
    turn = _rotations(start, arrival) @ here.pose.rotation
    origin = place_m - range_m[:, None] * arrival
    frames = here.meshes.poses(here.time_s)
    back = np.stack([frame.rotation.T for frame in frames])[group]
    from_m = np.stack([frame.position_m for frame in frames])[group]
    legs = np.zeros((len(group), LEG_SIZE))
    legs[:, :3] = np.einsum("nij,nj->ni", back, origin - from_m)
    legs[:, 3:12] = (back @ turn).reshape(-1, 9)
    legs[:, 15] = 1.0
    return legs


def _rotations(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """The smallest rotations that turn unit vectors into others, (N, 3, 3) (Rodrigues)."""
    x, y, z = np.cross(start, end).T
    nothing = np.zeros_like(x)
    rows = [nothing, -z, y, z, nothing, -x, -y, x, nothing]
    skew = np.stack(rows, axis=1).reshape(-1, 3, 3)
    cosine = np.einsum("ij,ij->i", start, end)[:, None, None]
    rotation: NDArray[np.float64] = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation
