"""Point targets: exact echoes of things too small for a mesh."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.clouds import cloud_gain
from sonar_sim.propagation.mirror import RELATIVE_GAP, reaches_mirror
from sonar_sim.propagation.physics import Mirror
from sonar_sim.propagation.propagation_path import (
    OBJECT_STEP_S,
    PingGeometry,
    mirrored,
    single_bounce_gain,
)
from sonar_sim.propagation.refraction import EigenRay, eigenrays
from sonar_sim.scene.scene import PointTarget
from sonar_sim.scene.sonar import SonarSettings

HIDDEN_M = 0.01
"""A surface hides a target that lies farther than this behind it."""
MIN_SPREAD_M = 0.01
"""Right before the transducer nothing spreads as from a point, and no echo is infinite."""


def add_targets(
    cells: NDArray[np.complex64] | NDArray[np.float32],
    targets: tuple[PointTarget, ...],
    here: PingGeometry,
    sonar: SonarSettings,
    *,
    loss: NDArray[np.float32],
    taps: NDArray[np.float32],
    turns_per_m: float,
) -> None:
    """Add each target's echo by each way, in place.

    Args:
        cells: field or mean power, (rows, columns).
        targets: that may echo.
        here: the ping.
        sonar: settings.
        loss: pressure at each row's range, of source level and absorption both ways, (rows,).
        taps: spread of an echo between columns, (F, even).
        turns_per_m: 1 / wavelength.
    """
    speed_mps = sonar.frequency_hz / turns_per_m
    for target in targets:
        position, velocity_mps = _struck(here, target)
        for there, back, gain in _ways(here, position, speed_mps):
            way = _TargetPath(here, there, back, position, velocity_mps)
            pressure = gain * 10.0 ** (target.target_strength_db / 20.0) * way.factor
            _deposit(cells, way, pressure, sonar, loss=loss, taps=taps, turns_per_m=turns_per_m)


class _TargetPath:
    """Where a target shows by one way, and what the way leaves of its pressure."""

    def __init__(
        self,
        here: PingGeometry,
        there: FramePose,
        back: FramePose,
        position_m: NDArray[np.float64],
        velocity_mps: NDArray[np.float64],
    ) -> None:
        physics = here.physics
        out = there.rotation.T @ (position_m - there.position_m)
        heard = back.rotation.T @ (position_m - back.position_m)
        out_m, heard_m = (max(float(np.linalg.norm(v)), 1e-6) for v in (out, heard))
        self.way_m = 0.5 * (out_m + heard_m)
        self.sine = -heard[1] / heard_m
        leaves, arrives = out / out_m, heard / heard_m
        opening = velocity_mps @ (there.rotation @ leaves + back.rotation @ arrives)
        if here.motion is not None:
            # By a mirror, directions from the image are those from the sonar in its own frame.
            real = here.pose if np.linalg.det(back.rotation) < 0.0 else back
            ways = here.pose.rotation @ leaves + real.rotation @ arrives
            opening -= here.motion.linear_mps @ ways
        self.apparent_m = self.way_m * physics.range_scale - physics.doppler_shift_s * opening / 2.0
        self.factor = 1.0
        if physics.vertical_width_rad is not None:
            up = np.array([out[2] / out_m, heard[2] / heard_m])
            two_way = vertical_two_way_power(up, physics.vertical_width_rad)
            self.factor = float(np.prod(two_way)) ** 0.25
        if physics.spreading:
            self.factor /= max(out_m, MIN_SPREAD_M) * max(heard_m, MIN_SPREAD_M)
        if out[0] <= 0.0 or heard[0] <= 0.0:
            self.factor = 0.0  # a line array cannot tell ahead from astern: its housing does


def _ways(
    here: PingGeometry, position_m: NDArray[np.float64], speed_mps: float
) -> list[tuple[FramePose, FramePose, float]]:
    """Transmit pose, receive pose and pressure gain of each path."""
    ways: list[tuple[FramePose, FramePose, float]] = []
    direct = _direct(here, position_m, speed_mps)
    if direct:
        gain = _cloud_gain(here, position_m)
        ways += [(there, back, gain) for there, back in direct]
    for mirror in here.physics.mirrors:
        image = mirrored(here.pose, mirror)
        if image is None or not _sees_via_mirror(here, mirror, image, position_m):
            continue
        if direct:
            pair = single_bounce_gain(here, image, position_m[None, :])
            once = mirror.reflection * float(pair[0])
            ways += [(here.pose, image, once), (image, here.pose, once)]
        ways.append((image, image, mirror.reflection**2))
    return ways


def _direct(
    here: PingGeometry, position_m: NDArray[np.float64], speed_mps: float
) -> list[tuple[FramePose, FramePose]]:
    """Poses there and back of what gets to a target without a mirror.

    A bent path is a straight one from a virtual sonar that looks like the real one and stands as
    far away as the travel time says, in the direction in which the path leaves. On bent paths the
    sonar is taken to stand still, as for surfaces; by a mirror paths are straight.
    """
    layers = here.physics.layers
    if layers is None:
        if here.physics.shadows and not _unobstructed(here, here.pose.position_m, position_m):
            return []
        return [(here.pose, _receive_pose(here, position_m))]
    paths = [
        FramePose(position_m - ray.range_m * ray.direction, here.pose.rotation)
        for ray in eigenrays(layers, here.pose.position_m, position_m, speed_mps)
        if not here.physics.shadows or _free_along(here, ray)
    ]
    return [(there, back) for there in paths for back in paths]


def _free_along(here: PingGeometry, ray: EigenRay) -> bool:
    """Whether nothing stands in the way of a bent path to a target at its end."""
    piece = np.diff(ray.corner_m, axis=0)
    length_m = np.linalg.norm(piece, axis=1)
    real = np.flatnonzero(length_m > 0.0)
    direction = (piece[real] / length_m[real, None]).astype(np.float32)
    left_m = np.cumsum(length_m[real][::-1])[::-1]
    reach_m = float(length_m.max())
    # From the sonar, and not from points of its own, rays leave the face that it may lie in.
    first = here.meshes.cast(here.pose.position_m, direction[:1], here.time_s, reach_m, 1)
    later = here.meshes.cast(ray.corner_m[real[1:]], direction[1:], here.time_s, reach_m, 1)
    face = np.concatenate([first.face, later.face])
    range_m = np.concatenate([first.range_m, later.range_m])
    hidden = (face >= 0) & (range_m < length_m[real]) & (range_m < left_m - HIDDEN_M)
    return not hidden.any()


def _sees_via_mirror(
    here: PingGeometry, mirror: Mirror, image: FramePose, position_m: NDArray[np.float64]
) -> bool:
    """Whether sound gets to a target by a mirror, unhindered on both parts of the way."""
    height = float(np.dot(mirror.normal, position_m - mirror.point_m))
    image_height = float(np.dot(mirror.normal, image.position_m - mirror.point_m))
    if height <= 0.0:
        return False
    along = image_height / (image_height - height)
    foot = image.position_m + along * (position_m - image.position_m)
    way = foot - here.pose.position_m
    range_m = np.linalg.norm(way[None, :], axis=1)
    direction = (way / range_m).astype(np.float32)[None, :]
    reach_m = 2.0 * here.range_m
    met = here.meshes.cast(here.pose.position_m, direction, here.time_s, reach_m, 1)
    if not reaches_mirror(here.meshes, mirror, met.face, met.range_m, range_m)[0]:
        return False
    return not here.physics.shadows or _unobstructed(
        here, foot + RELATIVE_GAP * mirror.normal, position_m
    )


def _unobstructed(
    here: PingGeometry, start_m: NDArray[np.float64], position_m: NDArray[np.float64]
) -> bool:
    """Whether nothing stands between a point and a target."""
    way = position_m - start_m
    range_m = max(float(np.linalg.norm(way)), 1e-9)
    direction = (way / range_m).astype(np.float32)[None, :]
    met = here.meshes.cast(start_m, direction, here.time_s, range_m, 1)
    return bool(met.face[0] < 0 or met.range_m[0] > range_m - HIDDEN_M)


def _struck(
    here: PingGeometry, target: PointTarget
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position and velocity of a target when the sound reaches it, map frame."""
    start_m = target.position_at_m(here.time_s)
    if target.motion is None:
        return start_m, np.zeros(3)
    velocity_mps = (target.position_at_m(here.time_s + OBJECT_STEP_S) - start_m) / OBJECT_STEP_S
    if here.physics.pose_blocks == 1:
        return start_m, velocity_mps
    return target.position_at_m(here.time_s + _echo_s(here, start_m) / 2.0), velocity_mps


def _receive_pose(here: PingGeometry, position_m: NDArray[np.float64]) -> FramePose:
    """The sonar's pose when the echo arrives."""
    if here.motion is None or here.physics.pose_blocks == 1:
        return here.pose
    return here.motion.pose(here.pose, _echo_s(here, position_m))


def _echo_s(here: PingGeometry, position_m: NDArray[np.float64]) -> float:
    """From the transmission to the echo's arrival."""
    range_m = float(np.linalg.norm(position_m - here.pose.position_m))
    return here.listening_s * range_m / here.range_m


def _cloud_gain(here: PingGeometry, position_m: NDArray[np.float64]) -> float:
    way = position_m - here.pose.position_m
    range_m = np.array([max(float(np.linalg.norm(way)), 1e-9)])
    direction = (way / range_m).astype(np.float32)[None, :]
    return float(cloud_gain(here.physics.clouds, here.pose.position_m, direction, range_m)[0])


def _deposit(
    cells: NDArray[np.complex64] | NDArray[np.float32],
    way: _TargetPath,
    pressure: float,
    sonar: SonarSettings,
    *,
    loss: NDArray[np.float32],
    taps: NDArray[np.float32],
    turns_per_m: float,
) -> None:
    rows, columns = cells.shape
    row = int(way.apparent_m / sonar.range_resolution_m)
    place = way.sine / sonar.sine_pitch + (columns - 1) / 2.0
    whole = int(np.floor(place))
    count = taps.shape[1]
    first = whole - (count // 2 - 1)
    if not 0 <= row < rows or first < 0 or first + count > columns:
        return
    weights = taps[min(int((place - whole) * len(taps)), len(taps) - 1)]
    heard = pressure * float(loss[row])
    if np.iscomplexobj(cells):
        turns = 2.0 * way.way_m * turns_per_m
        wave = heard * np.exp(2j * np.pi * (turns - np.floor(turns)))
        cells[row, first : first + count] += (weights * wave).astype(np.complex64)
    else:
        cells[row, first : first + count] += (weights * heard**2).astype(np.float32)
