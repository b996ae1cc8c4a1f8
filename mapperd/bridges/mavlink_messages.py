"""What an autopilot is told, as plain numbers: poses in NED or FRD, obstacles, texts.

Fields, units and frames: the common message set of MAVLink (mavlink.io).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.bridges.vehicle import VehiclePose
from mapperd.export.cells import FREE, OCCUPIED, UNKNOWN, GridLayer
from mapperd.geometry.frames import (
    BODY_TO_FLU,
    WORLD_TO_ENU,
    World,
    angles_of,
    orientation_from_map,
    quaternion_to_matrix,
)
from mapperd.localization.scan import yaw_of

__all__ = [
    "SECTORS",
    "UNKNOWN_CM",
    "AutopilotPose",
    "JumpCounter",
    "autopilot_pose",
    "obstacle_distances",
    "text_chunks",
]

Floats = NDArray[np.float64]

UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True, eq=False)
class AutopilotPose:
    """A pose in the autopilot's axes.

    Attributes:
        time_us: Unix time.
        position_m: (3,), north east down, or forward right down of the map's axes.
        quaternion: (4,) w, x, y, z: from body FRD to those axes.
        angles_rad: roll, pitch, yaw of the same.
        velocity_mps: (3,), body FRD; NaN if unknown.
        covariance: (21,), upper triangle row by row of x, y, z, roll, pitch, yaw; the first is NaN
            if it is unknown.
    """

    time_us: int
    position_m: Floats
    quaternion: Floats
    angles_rad: tuple[float, float, float]
    velocity_mps: Floats
    covariance: Floats


def autopilot_pose(located: VehiclePose, world: World) -> AutopilotPose:
    """Convert a pose from the map (ENU or its own axes, FLU) to an autopilot's axes.

    Args:
        located: pose in the map.
        world: `ned` if the map's y is north, `local_frd` if its heading is arbitrary.
    """
    to_world = WORLD_TO_ENU[world]  # its own inverse
    turn = orientation_from_map(located.pose.map_q_base, world, "frd")
    turn = turn if turn[0] >= 0 else -turn  # the same orientation
    angles = angles_of(turn)
    velocity = np.full(3, np.nan)
    if located.velocity_mps is not None:
        in_base = quaternion_to_matrix(located.pose.map_q_base).T @ located.velocity_mps
        velocity = BODY_TO_FLU["frd"] @ in_base
    covariance = np.full(21, np.nan)
    if located.covariance is not None:
        to_angles = _angle_rates(angles) @ to_world
        change = np.zeros((6, 6))
        change[:3, :3], change[3:, 3:] = to_world, to_angles
        covariance = (change @ located.covariance @ change.T)[UPPER]
    return AutopilotPose(
        located.stamp_ns // 1000,
        to_world @ located.pose.position_m,
        turn,
        angles,
        velocity,
        covariance,
    )


def _angle_rates(angles_rad: tuple[float, float, float]) -> Floats:
    """Return (3, 3): small rotations about the world's axes to changes of roll, pitch and yaw."""
    _, pitch, yaw = angles_rad
    c, s = math.cos(pitch), math.sin(pitch)
    about_world = np.array(
        [
            [c * math.cos(yaw), -math.sin(yaw), 0.0],
            [c * math.sin(yaw), math.cos(yaw), 0.0],
            [-s, 0.0, 1.0],
        ]
    )
    inverse: Floats = np.linalg.pinv(about_world)  # a vehicle on its nose has no roll of its own
    return inverse


MAX_GAP_NS = 2_000_000_000
JUMP_M, JUMP_MPS = 0.5, 2.0
JUMP_RAD, JUMP_RADPS = math.radians(15), math.radians(60)
"""Changes beyond these, and beyond these rates, are jumps: no vehicle of this size moves so."""


class JumpCounter:
    """The reset counter of an estimate: it counts up when the estimate jumps, or starts again."""

    def __init__(self) -> None:
        self._count = 0
        self._last: VehiclePose | None = None
        self._lost = False

    def lose(self) -> None:
        """Note that the estimate was lost; the next one begins again."""
        self._lost = self._last is not None

    def take(self, located: VehiclePose) -> int:
        """Return the counter for a pose, 0 to 255."""
        last, self._last = self._last, located
        if last is not None and (self._lost or _is_jump(last, located)):
            self._count = (self._count + 1) % 256
        self._lost = False
        return self._count


def _is_jump(last: VehiclePose, now: VehiclePose) -> bool:
    passed_ns = now.stamp_ns - last.stamp_ns
    if not 0 <= passed_ns <= MAX_GAP_NS:
        return True
    passed_s = passed_ns / 1e9
    velocity = np.zeros(3) if last.velocity_mps is None else last.velocity_mps
    step_m = now.pose.position_m - last.pose.position_m - velocity * passed_s
    if float(np.linalg.norm(step_m)) > JUMP_M + JUMP_MPS * passed_s:
        return True
    cosine = min(abs(float(last.pose.map_q_base @ now.pose.map_q_base)), 1.0)
    return 2 * math.acos(cosine) > JUMP_RAD + JUMP_RADPS * passed_s


SECTORS = 72
SECTOR_RAD = math.tau / SECTORS
UNKNOWN_CM = 65535
OWN_M = 1.0
"""Within this distance of its origin the vehicle itself is, and no free water is needed."""

AROUND = np.stack(np.meshgrid((-0.5, 0.0, 0.5), (-0.5, 0.0, 0.5)), axis=-1).reshape(-1, 2)
"""(9, 2): centre, corners and edges of a cell, in cells."""


def obstacle_distances(
    layer: GridLayer | None,
    cell_m: float,
    points_m: Floats,
    located: VehiclePose,
    range_m: float,
) -> NDArray[np.uint16]:
    """Return the distance of the nearest obstacle by sector, clockwise from ahead.

    Args:
        layer: horizontal slice of the map around the vehicle; None if nothing is known of it.
        cell_m: edge of a cell of the slice.
        points_m: (N, 3) returns of the latest ping at the height of the slice, map frame.
        located: the vehicle in the frame of both.
        range_m: obstacles farther away do not count.

    Returns:
        (72,) centimetres; one more than the range where the map is free up to there, 65535 where
        it is not known.
    """
    place_m, yaw = located.pose.position_m[:2], yaw_of(located.pose.map_q_base)
    found = [points_m[:, :2] - place_m]
    if layer is not None:
        y, x = np.nonzero(layer.values == OCCUPIED)
        centres = np.stack([x + layer.window.x, y + layer.window.y], axis=1) + 0.5
        found.append((centres[:, None] + AROUND).reshape(-1, 2) * cell_m - place_m)
    offset = np.concatenate(found)
    distance_m = np.hypot(offset[:, 0], offset[:, 1])
    offset, distance_m = offset[distance_m <= range_m], distance_m[distance_m <= range_m]
    clockwise = yaw - np.arctan2(offset[:, 1], offset[:, 0])
    sector = np.rint(clockwise / SECTOR_RAD).astype(np.int64) % SECTORS
    nearest_m = np.full(SECTORS, np.inf)
    np.minimum.at(nearest_m, sector, distance_m)
    hit_m, is_clear = _along_rays(layer, cell_m, place_m, yaw, range_m)
    nearest_m = np.minimum(nearest_m, hit_m)
    nothing = np.where(is_clear, range_m + 0.01, np.nan)
    centimetres = np.rint(100 * np.where(np.isfinite(nearest_m), nearest_m, nothing))
    return np.where(np.isnan(centimetres), UNKNOWN_CM, np.maximum(centimetres, 1)).astype(np.uint16)


def _along_rays(
    layer: GridLayer | None, cell_m: float, place_m: Floats, yaw: float, range_m: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Look along the middles of the sectors.

    Returns:
        (72,) metres to the first occupied cell, or infinity; (72,) whether all cells outside the
        vehicle are free.
    """
    if layer is None:
        return np.full(SECTORS, np.inf), np.zeros(SECTORS, np.bool_)
    bearing = yaw - SECTOR_RAD * np.arange(SECTORS)
    along_m = np.arange(0.0, range_m, cell_m / 4)
    way = along_m[None, :, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)[:, None]
    index = np.floor((place_m + way) / cell_m).astype(np.int64)
    index -= (layer.window.x, layer.window.y)
    inside = ((index >= 0) & (index < (layer.window.width, layer.window.height))).all(axis=2)
    x, y = np.where(inside[..., None], index, 0).transpose(2, 0, 1)
    value = np.where(inside, layer.values[y, x], UNKNOWN)
    hit = value == OCCUPIED
    hit_m = np.where(hit.any(axis=1), along_m[hit.argmax(axis=1)], np.inf)
    outside = along_m >= OWN_M
    is_clear = (value[:, outside] == FREE).all(axis=1) & bool(outside.any())
    return hit_m, is_clear


TEXT_BYTES = 50
MAX_CHUNKS = 4


def text_chunks(text: str) -> Iterator[bytes]:
    """Yield a text in UTF-8 in pieces of at most 50 bytes, at most four; the rest is left out.

    A piece of exactly 50 bytes goes on in the next one.
    """
    rest = text.encode("utf-8", "replace")[: MAX_CHUNKS * TEXT_BYTES - 1]
    rest = rest.decode("utf-8", "ignore").encode()
    while True:
        yield rest[:TEXT_BYTES]
        if len(rest) < TEXT_BYTES:
            return
        rest = rest[TEXT_BYTES:]
