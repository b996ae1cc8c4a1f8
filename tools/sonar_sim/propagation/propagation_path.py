"""Propagation paths of the sound: direct, in motion, and by way of a mirror."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.matmul import rows_dot
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.clouds import cloud_gain
from sonar_sim.propagation.mirror import (
    MIRROR_GAP_M,
    RELATIVE_GAP,
    mirrored_fan,
    reaches_mirror,
)
from sonar_sim.propagation.physics import Mirror, Physics
from sonar_sim.raycast.fan import RayFan
from sonar_sim.raycast.meshes import NOTHING, Hits, Meshes
from sonar_sim.raycast.tracing import Trace, spans, trace

LEG_SIZE = 16
"""Numbers of a leg: origin (3), rotation (9), drift (3), gain (1)."""


def leg_in_frame(
    map_T_object: FramePose,  # noqa: N803
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    drift_m: NDArray[np.float64] | None = None,
    gain: float = 1.0,
) -> NDArray[np.float64]:
    """A leg of the map in an object's frame, (16,).

    Args:
        map_T_object: the object.
        origin_m: of the leg, map frame, (3,).
        rotation: map from sonar; may mirror, (3, 3).
        drift_m: growth of the apparent range per unit of direction, map frame, (3,).
        gain: of pressure.
    """
    back = map_T_object.rotation.T
    drift = np.zeros(3) if drift_m is None else back @ drift_m
    origin = back @ (origin_m - map_T_object.position_m)
    return np.concatenate([origin, (back @ rotation).ravel(), drift, [gain]])


OBJECT_STEP_S = 1e-3
REACH_MARGIN = 1.3
"""Rays from a mirror's image are cast to this multiple of the farthest audible range: a hit stands
for its surface as far as the hits of its neighbours tell."""


@dataclass(frozen=True, slots=True, eq=False)
class PingGeometry:
    """Scene, pose, motion and settings that all propagation paths of one ping share.

    Attributes:
        meshes: of the scene.
        physics: what to compute.
        pose: of the sonar at the transmission.
        motion: while it listens; None stands still.
        time_s: of the transmission.
        listening_s: from the transmission to the last row's echo.
        range_m: true range of the last row's end.
        heard: materials that send something back, (M,).
        threads: that share the rays.
    """

    meshes: Meshes
    physics: Physics
    pose: FramePose
    motion: SonarMotion | None
    time_s: float
    listening_s: float
    range_m: float
    heard: NDArray[np.bool_]
    threads: int

    def echoes(self, face: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which hits send something back, (N,), by their faces; negative is no hit."""
        echoes: NDArray[np.bool_] = self.heard.take(self.meshes.material.take(face))
        echoes &= face >= 0
        return echoes


def audible_materials(names: tuple[str, ...], physics: Physics) -> NDArray[np.bool_]:
    """All but the silent surfaces', and the sea's if it scatters, (M,)."""
    return np.array([*(name not in physics.silent for name in names), physics.sea_surface])


def direct_paths(here: PingGeometry, rays: Trace) -> list[_core.Rays]:
    """Straight to what was met and straight back to where the sonar is by then."""
    legs = _LegTable(here)
    ways = []
    for met in rays.met:
        echoes = here.echoes(met.face)
        gain = np.ones(len(met.face), dtype=np.float32)
        if here.physics.clouds:
            hit = np.flatnonzero(echoes)
            path = met.range_m[hit].astype(np.float64)
            direction = rays.direction[hit]
            gain[hit] = cloud_gain(here.physics.clouds, rays.origin_m, direction, path)
        ways.append(
            _core.Rays(
                face=np.where(echoes, met.face, np.int32(NOTHING)),
                seen=met.group,
                transmit=legs.transmit(met.group, met.range_m),
                receive=legs.receive(met.group, met.range_m),
                cell=rays.fan.cell,
                span_m=spans(here.meshes, rays.fan, met),
                gain=gain,
                legs=legs.rows,
                lean=rays.fan.lean,
            )
        )
    return ways


class _LegTable:
    """Legs of each group at the transmission, then of each block of the listening time.

    An echo leaves an object in the middle between transmission and reception: there and back the
    object stands where it is then. Its rays are cast at the transmission.
    """

    def __init__(self, here: PingGeometry) -> None:
        moves = here.motion is not None or here.meshes.moving
        self._blocks = here.physics.pose_blocks if moves else 1
        self._block_m = here.range_m / self._blocks
        start = here.meshes.poses(here.time_s)
        self._groups = len(start)
        self._moving = here.meshes.moving
        drifts = [_drift(here, number) for number in range(self._groups)]
        rows = [
            leg_in_frame(frame, here.pose.position_m, here.pose.rotation, drift)
            for frame, drift in zip(start, drifts, strict=True)
        ]
        if self._blocks > 1:
            after_s = (np.arange(self._blocks) + 0.5) / self._blocks * here.listening_s
            frames = [here.meshes.poses(here.time_s + float(s) / 2.0) for s in after_s]
            poses = [here.pose] * self._blocks
            if here.motion is not None:
                poses = [here.motion.pose(here.pose, float(s)) for s in after_s]
            # Back, then there.
            for sonar in (poses, [here.pose] * self._blocks):
                rows += [
                    leg_in_frame(frame, pose.position_m, pose.rotation, drift)
                    for pose, then in zip(sonar, frames, strict=True)
                    for frame, drift in zip(then, drifts, strict=True)
                ]
        self.rows = np.array(rows)

    def transmit(self, group: NDArray[np.int32], range_m: NDArray[np.float32]) -> NDArray[np.int32]:
        """Leg by which the sound goes to an echo at a range."""
        if self._blocks == 1 or not self._moving:
            return group
        there = self.receive(group, range_m) + np.int32(self._blocks * self._groups)
        return np.asarray(there, dtype=np.int32)

    def receive(self, group: NDArray[np.int32], range_m: NDArray[np.float32]) -> NDArray[np.int32]:
        """Leg by which an echo from a range comes back."""
        if self._blocks == 1:
            return group
        # In float until it fits: the range to nothing is infinite.
        last = np.float32(self._blocks - 1)
        block = np.minimum(range_m / np.float32(self._block_m), last).astype(np.int32)
        legs: NDArray[np.int32] = ((block + 1) * self._groups + group).astype(np.int32)
        return legs


def _drift(here: PingGeometry, group: int) -> NDArray[np.float64]:
    """Growth of the apparent range by a closing speed of each direction's own, map frame.

    An object's own turning is left out.
    """
    if here.physics.doppler_shift_s == 0.0:
        return np.zeros(3)
    own = np.zeros(3) if here.motion is None else np.asarray(here.motion.linear_mps)
    now = here.meshes.poses(here.time_s)[group].position_m
    soon = here.meshes.poses(here.time_s + OBJECT_STEP_S)[group].position_m
    drift: NDArray[np.float64] = here.physics.doppler_shift_s * (own - (soon - now) / OBJECT_STEP_S)
    return drift


def mirror_paths(
    here: PingGeometry, fan: RayFan, mirror: Mirror, reach_m: float, known: Hits | None = None
) -> list[_core.Rays]:
    """Paths with a mirror on the way out, back, or both; the sonar is taken to stand still.

    The mirror's image of the sonar sees what the sonar sees in the mirror. Its rays begin on the
    mirror, where the sonar's own ray got there unhindered.

    Args:
        here: the ping.
        fan: of rays, not yet refined.
        mirror: a plane of multipath.
        reach_m: a mirror that lies farther is not met.
        known: what the sonar's own rays of the fan met within that range, if they were cast.
    """
    image = mirrored(here.pose, mirror)
    if image is None:
        return []
    seen = _seen_in_mirror(here, fan, mirror, image, reach_m, known=known)
    met = seen.met[0]
    hit = np.flatnonzero(here.echoes(met.face))
    frames = here.meshes.poses(here.time_s)
    direct = [leg_in_frame(f, here.pose.position_m, here.pose.rotation) for f in frames]
    bounced = [
        leg_in_frame(f, image.position_m, image.rotation, gain=mirror.reflection) for f in frames
    ]
    legs = np.array([*direct, *bounced]).reshape(-1, LEG_SIZE)
    range_m = met.range_m.take(hit)
    point_m = range_m[:, None].astype(np.float64) * seen.direction.take(hit, axis=0)
    point_m += image.position_m
    span = spans(here.meshes, seen.fan, met)
    by_mirror = met.group + np.int32(len(frames))

    def way(
        its: NDArray[np.int64],
        back: NDArray[np.int32],
        gain: NDArray[np.float64] | float = 1.0,
        *,
        both_ways: bool = False,
    ) -> _core.Rays:
        face = np.full(len(met.face), NOTHING, dtype=np.int32)
        gains = np.zeros(len(met.face), dtype=np.float32)
        face[its], gains[its] = met.face.take(its), gain
        return _core.Rays(
            face=face,
            seen=by_mirror,
            transmit=by_mirror,
            receive=back,
            cell=seen.fan.cell,
            span_m=span,
            gain=gains,
            legs=legs,
            both_ways=both_ways,
            lean=seen.fan.lean,
        )

    once = _in_sight(here, point_m, 2.0 * here.range_m - range_m)
    pair = single_bounce_gain(here, image, point_m.take(once, axis=0))
    both = hit[range_m < here.range_m]
    return [way(hit.take(once), met.group, pair, both_ways=True), way(both, by_mirror)]


def single_bounce_gain(
    here: PingGeometry, image: FramePose, point_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gain of the two ways to points (N, 3) that use a mirror once: there or back, (N,).

    They are equally long, so their pressures add: where a beam hears both, the sum of their mean
    powers is up to 3 dB too small. What beams hear of both is the correlation of two Gaussian beams
    as far apart as the two bearings; without an azimuth pattern all of it.
    """
    width_rad = here.physics.beam_width_rad
    if here.physics.speckle or width_rad is None:
        return np.full(len(point_m), 1.0 if here.physics.speckle else math.sqrt(2.0))
    sines = []
    for pose in (here.pose, image):
        way = point_m - pose.position_m
        sines.append(way @ pose.rotation[:, 1] / np.maximum(np.linalg.norm(way, axis=1), 1e-9))
    apart = (sines[0] - sines[1]) / width_rad
    return np.asarray(np.sqrt(1.0 + np.exp(-math.log(2.0) * np.square(apart))))


def mirrored(pose: FramePose, mirror: Mirror) -> FramePose | None:
    """The mirror's image of a pose, or None behind the mirror."""
    height = float(np.dot(mirror.normal, pose.position_m - mirror.point_m))
    if height <= 0.0:
        return None
    moved = pose.position_m - 2.0 * height * mirror.normal
    return FramePose(moved, _reflector(mirror) @ pose.rotation)


def _reflector(mirror: Mirror) -> NDArray[np.float64]:
    reflector: NDArray[np.float64] = np.eye(3) - 2.0 * np.outer(mirror.normal, mirror.normal)
    return reflector


def _seen_in_mirror(
    here: PingGeometry,
    fan: RayFan,
    mirror: Mirror,
    image: FramePose,
    reach_m: float,
    *,
    known: Hits | None,
) -> Trace:
    """What rays meet after the mirror, from the image."""
    height = float(np.dot(mirror.normal, here.pose.position_m - mirror.point_m))
    # From a point P, |P - image| <= |P - sonar| + 2 height: of a path that is not longer than
    # 2 range the first is at most range + height.
    far_m = min(REACH_MARGIN * (here.range_m + height), 2.0 * here.range_m)
    reflector = _reflector(mirror).astype(np.float32)
    part, kept = mirrored_fan(fan, mirror, image, height, far_m)

    def cast(onward: NDArray[np.float32], own: Hits | None = None) -> Hits:
        crossing = height / np.maximum(rows_dot(onward, mirror.normal), 1e-9)
        ray = np.flatnonzero(crossing < far_m)
        going, crossing = onward.take(ray, axis=0), crossing.take(ray)
        if own is None:
            # The sonar's own ray is the mirror image of the image's.
            direction = _core.rotated(going, reflector)
            first = here.meshes.cast(
                here.pose.position_m, direction, here.time_s, reach_m, here.threads
            )
        else:
            first = own.take(ray)
        there = np.flatnonzero(
            reaches_mirror(here.meshes, mirror, first.face, first.range_m, crossing)
        )
        ray, going = ray.take(there), going.take(there, axis=0)
        behind = crossing.take(there) * (1.0 + RELATIVE_GAP / height)
        met = here.meshes.cast(
            image.position_m,
            going,
            here.time_s,
            far_m,
            here.threads,
            near_m=behind.astype(np.float32),
        )
        all_rays = Hits.empty(len(onward), np.inf)
        all_rays.range_m[ray] = met.range_m
        all_rays.face[ray], all_rays.group[ray] = met.face, met.group
        return all_rays

    return trace(
        here.meshes,
        part,
        image,
        here.time_s,
        far_m,
        threads=here.threads,
        cast=cast,
        first_cast=lambda onward: cast(onward, None if known is None else known.take(kept)),
        real_sonar=here.pose,
    )


def _in_sight(
    here: PingGeometry, point_m: NDArray[np.float64], reach_m: NDArray[np.float32]
) -> NDArray[np.int64]:
    """Indices of the points that the sonar sees directly, no farther than their reach."""
    way = point_m - here.pose.position_m
    range_m = np.maximum(np.sqrt(rows_dot(np.square(way), np.ones(3))), 1e-9)
    near = np.flatnonzero(range_m < reach_m)
    way, range_m = way.take(near, axis=0), range_m.take(near)
    direction = (way / range_m[:, None]).astype(np.float32)
    met = here.meshes.cast(
        here.pose.position_m, direction, here.time_s, 2.0 * here.range_m, here.threads
    )
    clear = (met.face < 0) | (met.range_m > range_m * (1.0 - RELATIVE_GAP) - MIRROR_GAP_M)
    return near[clear]
