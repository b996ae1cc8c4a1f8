"""Encodes poses, paths, pings and images as messages of the map stream."""

import math
import threading

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.geometry.frames import Pose, pose_from_rpy, quaternion_product, quaternion_to_matrix
from mapperd.imaging.ping_image import PingImage, beams_in_view, display_units, ping_image_of
from mapperd.localization.status import LocalizationSnapshot
from mapperd.pipeline.step import PingResult
from mapperd.wire.messages import FanMessage, ImageMessage, PoseMessage, ReturnsMessage
from oculus_driver.ping import Ping

__all__ = [
    "IMAGE_SIZES",
    "SonarMounting",
    "VehiclePath",
    "fan_message",
    "first_returns",
    "image_message",
    "localized_covariance",
    "pose_message",
    "returns_message",
]

Floats = NDArray[np.float64]

FINE_RAD, FINE_M = 1e-4, 1e-3
"""Rounding of a fan: the measured speed of sound makes its range vary slightly."""


class SonarMounting:
    """Pose of the sonar on the base.

    Args:
        config: has the mounting.
    """

    def __init__(self, config: Config) -> None:
        place, turn = config.mounting.position, config.mounting.orientation
        self._base = pose_from_rpy((place.x, place.y, place.z), (turn.roll, turn.pitch, turn.yaw))

    def of_sonar(self, base: Pose) -> Pose:
        """Return the sonar's pose for a pose of the base, both in the map frame."""
        offset = quaternion_to_matrix(base.map_q_base) @ self._base.position_m
        turn = quaternion_product(base.map_q_base, self._base.map_q_base)
        return Pose(base.position_m + offset, turn / np.linalg.norm(turn))


def pose_message(
    base: Pose,
    sonar: Pose,
    *,
    stamp_ns: int,
    source: str,
    velocity_mps: Floats | None = None,
    covariance: Floats | None = None,
    odom: Pose | None = None,
) -> PoseMessage:
    """Return the message of a pose; a covariance that is not finite is left out."""
    return PoseMessage(
        stamp_ns=max(stamp_ns, 0),
        position_m=_three(base.position_m),
        orientation_xyzw=_xyzw(base.map_q_base),
        velocity_mps=None if velocity_mps is None else _three(velocity_mps),
        covariance=_finite(covariance),
        sonar_position_m=_three(sonar.position_m),
        sonar_orientation_xyzw=_xyzw(sonar.map_q_base),
        source=source,
        odom_position_m=None if odom is None else _three(odom.position_m),
        odom_orientation_xyzw=None if odom is None else _xyzw(odom.map_q_base),
    )


def localized_covariance(snapshot: LocalizationSnapshot) -> Floats | None:
    """Return the covariance (6, 6) of the estimate, 0 for height, roll and pitch (odometry's)."""
    if snapshot.belief is None:
        return None
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = snapshot.belief.best.covariance
    return covariance


def fan_message(ping: Ping, config: Config) -> FanMessage | None:
    """Return the field of view of a ping; None if its bearings are not a fan."""
    try:
        view = beams_in_view(ping.bearings_rad, config.sonar)
    except MapError:
        return None
    first, last = ping.bearings_rad[view][[0, -1]].tolist()
    return FanMessage(
        bearings_rad=(_rounded(first, FINE_RAD), _rounded(last, FINE_RAD)),
        vertical_aperture_rad=math.radians(config.sonar.vertical_aperture),
        min_range_m=min(config.filtering.min_range, ping.max_range_m),
        max_range_m=_rounded(ping.max_range_m, FINE_M),
    )


def _rounded(value: float, step: float) -> float:
    return round(value / step) * step


def _three(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _xyzw(quaternion: Floats) -> tuple[float, float, float, float]:
    w, x, y, z = quaternion.tolist()
    return x, y, z, w


def _finite(covariance: Floats | None) -> tuple[float, ...] | None:
    if covariance is None or not np.isfinite(covariance).all():
        return None
    return tuple(covariance.ravel().tolist())


IMAGE_SIZES = ((512, 256), (256, 128), (128, 64))
"""Maximum rows and beams of an image, finest first: slower links get a coarser image."""

_COMPRESSOR = zstandard.ZstdCompressor(level=1)


def returns_message(
    result: PingResult, sonar: Pose | None, config: Config
) -> ReturnsMessage | None:
    """Return the first return of each beam; None if the ping's bearings are not a fan.

    Args:
        result: the processed ping.
        sonar: pose of the sonar, map frame; None if unknown.
        config: the settings.
    """
    ping, image = result.posed.ping, result.image
    if image is None:
        try:
            image = ping_image_of(ping, config.sonar)
        except MapError:
            return None
    points, intensities = first_returns(image, config)
    turn = None if sonar is None else sonar.map_q_base.tolist()
    return ReturnsMessage(
        stamp_ns=max(result.posed.complete_ns or 0, 0),
        ping_id=ping.ping_id,
        sonar_position_m=None if sonar is None else tuple(sonar.position_m.tolist()),
        sonar_orientation_xyzw=None if turn is None else (*turn[1:], turn[0]),
        outcome="mapped" if result.reject is None else result.reject.reason,
        points=points.astype("<f4").tobytes(),
        intensities=intensities.tobytes(),
    )


def first_returns(
    image: PingImage, config: Config
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Find the nearest sample of each beam above `filtering.intensity_threshold`.

    Returns:
        points (N, 3) float32, metres, sonar frame, and their intensities (N,) uint8.
    """
    step_m = image.range_resolution_m
    nearest = int(np.ceil(config.filtering.min_range / step_m))
    above = image.intensity[nearest:] > config.filtering.intensity_threshold
    if not len(above):
        return np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)
    row = above.argmax(axis=0)
    beam = np.flatnonzero(above[row, np.arange(above.shape[1])])
    row = row[beam] + nearest
    range_m, bearing = (row + 0.5) * step_m, image.bearings_rad[beam]
    points = np.zeros((len(beam), 3), np.float32)
    points[:, 0] = range_m * np.cos(bearing)
    points[:, 1] = -range_m * np.sin(bearing)
    return points, np.clip(np.rint(image.intensity[row, beam]), 0, 255).astype(np.uint8)


def image_message(ping: Ping, stamp_ns: int, most: tuple[int, int]) -> ImageMessage:
    """Reduce the image to a maximum of rows and beams; each pixel is the maximum of its samples."""
    rows, beams = ping.image.shape
    by_row, by_beam = -(-rows // most[0]), -(-beams // most[1])
    row, beam = np.arange(0, rows, by_row), np.arange(0, beams, by_beam)
    highest = np.maximum.reduceat(np.maximum.reduceat(ping.image, row, axis=0), beam, axis=1)
    pixels = np.clip(np.rint(display_units(highest, ping.full_scale)), 0, 255).astype(np.uint8)
    number = np.diff(np.append(beam, beams))
    bearings = np.add.reduceat(ping.bearings_rad, beam) / number
    return ImageMessage(
        stamp_ns=max(stamp_ns, 0),
        ping_id=ping.ping_id,
        rows=len(row),
        beams=len(beam),
        range_resolution_m=ping.range_resolution_m * by_row,
        bearings_rad=bearings.astype("<f4").tobytes(),
        body=_COMPRESSOR.compress(pixels.tobytes()),
    )


MAX_M = 1e30
"""Largest coordinate of a path: well within float32."""


class VehiclePath:
    """The path of the vehicle; one thread adds points, any thread reads them.

    A full path drops every second point, and doubles the spacing of new ones. The rest of the
    points get new numbers, and the version counts up.

    Args:
        most: maximum number of points, at least 2.
        spacing_m: distance between points.

    Attributes:
        version: of the numbering.
    """

    def __init__(self, most: int, spacing_m: float) -> None:
        self.version = 0
        self._points = np.zeros((max(most, 2), 3))
        self._count = 0
        self._spacing_m = spacing_m
        self._last: tuple[float, float, float] | None = None
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def add(self, position_m: NDArray[np.float64]) -> None:
        """Add the position of the vehicle, if it is far enough from the last point."""
        x, y, z = position_m.tolist()  # Python's floats: numpy's take several times as long
        if abs(x) + abs(y) + abs(z) > MAX_M:
            return
        last = self._last
        if last is not None:
            dx, dy, dz = x - last[0], y - last[1], z - last[2]
            if dx * dx + dy * dy + dz * dz < self._spacing_m * self._spacing_m:
                return
        self._last = (x, y, z)
        with self._lock:
            if self._count == len(self._points):
                self._thin()
            self._points[self._count] = self._last
            self._count += 1

    def since(self, version: int, first: int, most: int) -> tuple[int, int, NDArray[np.float64]]:
        """Return the next points for a client.

        Args:
            version: of the points that the client holds.
            first: number of the first point that it lacks.
            most: maximum number of points.

        Returns:
            the version, the number of the first point, and points (N, 3), metres, map frame.
        """
        with self._lock:
            if version != self.version or first > self._count:
                first = 0
            end = min(self._count, first + most)
            return self.version, first, self._points[first:end].copy()

    def _thin(self) -> None:
        kept = self._points[::2].copy()
        self._points[: len(kept)] = kept
        self._count = len(kept)
        self._spacing_m *= 2
        self.version += 1
