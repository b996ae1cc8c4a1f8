"""Checks of a daemon's messages: sizes and numbers that their types do not bound."""

import math
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd.client.mirror import names_of
from mapperd.errors import MapperdError
from mapperd.wire.blocks import UNKNOWN, BlockSet
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import (
    BLOCK_EDGE,
    MAX_FROM_SERVER,
    FanMessage,
    FromServer,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapBox,
    MapInfo,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
)

__all__ = [
    "AskError",
    "EndedError",
    "bearings_of",
    "check_blocks",
    "check_map_info",
    "check_message",
    "floats_of",
    "image_of",
    "places_of",
    "size_of",
]

UNIT_LOW, UNIT_HIGH = 0.9, 1.1
"""Bounds of a quaternion's length."""

MAX_BITS = 16
"""Counts are below 2**16."""


def check_message(message: FromServer) -> None:
    """Check the values of a message.

    Raises:
        StreamError: `bad_value`.
    """
    if isinstance(message, PoseMessage):
        _check_pose(message.position_m, message.orientation_xyzw)
        _check_pose(message.sonar_position_m, message.sonar_orientation_xyzw)
        _finite("a velocity", message.velocity_mps or ())
        _finite("a covariance", message.covariance or ())
        if message.odom_position_m is not None and message.odom_orientation_xyzw is not None:
            _check_pose(message.odom_position_m, message.odom_orientation_xyzw)
    elif isinstance(message, FanMessage):
        _check_fan(message)
    elif isinstance(message, ReturnsMessage):
        _check_returns(message)
    elif isinstance(message, ImageMessage):
        _check_image(message)
    elif isinstance(message, RobotsMessage):
        for _, *position_m in message.seen:
            _finite("the position of a robot", position_m)
    elif isinstance(message, LocalizationMessage):
        floats_of(message.particles, 4)
        floats_of(message.scan, 3)


def check_map_info(info: MapInfo) -> None:
    """Check what a server states about its map.

    Raises:
        StreamError: `bad_value`.
    """
    numbers = (info.resolution_m, info.log_odds_step, *(info.origin_deg or ()))
    _finite("a map", (*numbers, info.occupied_log_odds, info.free_log_odds))
    if info.free_log_odds > info.occupied_log_odds:
        raise StreamError("a map whose free threshold is above the occupied one", "bad_value")


def check_blocks(blocks: BlockSet, interest: Interest, cell_m: float) -> None:
    """Check that blocks were requested and have valid cells.

    Raises:
        StreamError: `bad_blocks`, or `not_asked`.
    """
    if len(set(names_of(blocks.keys))) != len(blocks):
        raise StreamError("a block twice in a message", "bad_blocks")
    if interest.detail == "classes" and ((blocks.cells > 1) | _between(blocks.cells)).any():
        raise StreamError("a cell with an unknown class", "bad_blocks")
    if blocks.counts is not None and (blocks.counts > MAX_BITS).any():
        raise StreamError("a count that is too large", "bad_blocks")
    if interest.box is not None:
        known = (blocks.cells != UNKNOWN).any(axis=1)
        _check_inside(blocks.keys[known], interest.box, cell_m)


def floats_of(data: bytes, columns: int) -> NDArray[np.float32]:
    """Decode finite float32 values, (N, columns).

    Raises:
        StreamError: `bad_value`.
    """
    if len(data) % (4 * columns):
        raise StreamError(f"{len(data)} bytes are not rows of {columns} numbers", "bad_value")
    rows = np.frombuffer(data, "<f4").reshape(-1, columns).astype(np.float32, copy=False)
    if not np.isfinite(rows).all():
        raise StreamError("a number that is not finite", "bad_value")
    return rows


def places_of(path: PathMessage) -> NDArray[np.float64]:
    """Decode the points (N, 3) of a piece of the path, metres, map frame.

    Raises:
        StreamError: `bad_value`.
    """
    points = floats_of(path.points, 3).astype(np.float64)
    rest = floats_of(path.rest, 3)
    if len(rest) not in (0, len(points)):
        raise StreamError("a path whose rest has another length", "bad_value")
    return points + rest if len(rest) else points


def image_of(message: ImageMessage) -> NDArray[np.uint8]:
    """Decode the samples of an image, (rows, beams) uint8, row 0 nearest.

    Raises:
        StreamError: `bad_value`.
    """
    size = message.rows * message.beams
    try:
        if zstandard.frame_content_size(message.body) != size:
            raise StreamError("an image whose size differs from its rows and beams", "bad_value")
        unpack = zstandard.ZstdDecompressor().decompress
        samples = unpack(message.body, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise StreamError(f"an image that cannot be unpacked: {error}", "bad_value") from error
    return np.frombuffer(samples, np.uint8).reshape(message.rows, message.beams)


def bearings_of(message: ImageMessage) -> NDArray[np.float64]:
    """Return the bearings (beams,) of an image, positive to starboard."""
    return np.frombuffer(message.bearings_rad, "<f4").astype(np.float64)


def size_of(value: Any) -> int:  # noqa: ANN401 plain values
    """Return the size of a value in bytes, as MessagePack."""
    try:
        return len(msgspec.msgpack.encode(value))
    except RecursionError:  # nested so deeply that it could only just be decoded
        return MAX_FROM_SERVER


def _check_pose(position_m: Iterable[float], orientation_xyzw: tuple[float, ...]) -> None:
    _finite("a position", position_m)
    if not UNIT_LOW < math.hypot(*orientation_xyzw) < UNIT_HIGH:
        raise StreamError("an orientation that is not a unit quaternion", "bad_value")


def _check_returns(returns: ReturnsMessage) -> None:
    if len(floats_of(returns.points, 3)) != len(returns.intensities):
        raise StreamError("returns without intensities", "bad_value")
    if returns.sonar_position_m is not None and returns.sonar_orientation_xyzw is not None:
        _check_pose(returns.sonar_position_m, returns.sonar_orientation_xyzw)


def _check_image(image: ImageMessage) -> None:
    image_of(image)
    if len(floats_of(image.bearings_rad, 1)) != image.beams:
        raise StreamError("an image whose bearings differ in number from its beams", "bad_value")
    _finite("the rows of an image", (image.range_resolution_m,))


def _check_fan(fan: FanMessage) -> None:
    first, last = fan.bearings_rad
    near, far = fan.min_range_m, fan.max_range_m
    _finite("a fan", (first, last, near, far, fan.vertical_aperture_rad))
    if not (-math.pi <= first <= last <= math.pi and 0 <= near <= far):
        raise StreamError("a fan with invalid limits", "bad_value")


def _check_inside(keys: NDArray[np.int32], box: MapBox, cell_m: float) -> None:
    """Check that blocks touch the box or are next to a block that does."""
    edge_m = BLOCK_EDGE * cell_m
    low = np.floor(np.asarray(box.low_m) / edge_m) - 1
    high = np.floor(np.asarray(box.high_m) / edge_m) + 1
    if ((keys < low) | (keys > high)).any():
        raise StreamError("a block outside of the requested box", "not_asked")


def _between(cells: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((cells < -1) & (cells != UNKNOWN))


def _finite(what: str, numbers: Iterable[float]) -> None:
    if not all(map(math.isfinite, numbers)):
        raise StreamError(f"{what} with numbers that are not finite", "bad_value")


FINAL = frozenset(
    {
        "bad_interest",
        "bad_version",
        "needs_token",
        "no_permission",
        "not_trusted",
        "too_many_blocks",
        "wrong_token",
    }
)
"""Reasons for which reconnecting does not help."""


class AskError(MapperdError):
    """The daemon did not carry out a request.

    Attributes:
        reason: one of docs/reference/control.md, or of the client itself: `not_connected`,
            `link_lost`, `no_answer`, `too_long`.
        details: plain values.
    """

    def __init__(self, reason: str, message: str, details: dict[str, object] | None = None) -> None:
        super().__init__(message)
        self.reason = reason
        self.details = details or {}


class EndedError(StreamError):
    """The daemon ended or refused the connection, or this client cannot use it."""

    @property
    def is_final(self) -> bool:
        """Whether reconnecting does not help."""
        return self.reason in FINAL
