"""Full ping results (message 0x22), as far as the vendor's public header names their fields.

A sonar sends them only after a full fire message, which is not public. Most fields have no name, so
a full ping is no `Ping`: it has no frequency, speed of sound, range resolution or ping id.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from oculus_driver.errors import Reject
from oculus_driver.fan import CENTIDEGREE_RAD
from oculus_driver.wire import FULL_PING_RESULT, MessageId

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.stream import Message


_SAMPLES: Final[dict[int, np.dtype[Any]]] = {
    1: np.dtype("u1"),
    2: np.dtype("<u2"),
    4: np.dtype("<u4"),
}
"""Type of a sample by its size in bytes."""


@dataclass(frozen=True, slots=True, eq=False)
class FullPing:
    """One full ping result. Arrays are read-only; the image is a view of the message's bytes.

    Attributes:
        arrival_ns: arrival time of the first byte of the message on the stream's clock, or None.
        offset: offset of the message in its stream.
        source_id: low 16 bits of the sonar's device id.
        range_m: configured range, metres; NaN if not finite.
        rows, beams: number of ranges and of bearings.
        bearings_rad: float64 (beams,), positive to starboard.
        image: (rows, beams) of uint8, uint16 or uint32; None if the size of the image does not fit
            such samples. The order of the rows is not documented.
        image_bytes: the bytes of the image as sent.
    """

    arrival_ns: int | None
    offset: int
    source_id: int
    range_m: float
    rows: int
    beams: int
    bearings_rad: NDArray[np.float64] = field(repr=False)
    image: NDArray[Any] | None = field(repr=False)
    image_bytes: bytes = field(repr=False)


def decode_full_ping(message: Message) -> FullPing | Reject:
    """Return the full ping in a message, or why the message is not one."""
    data, layout = message.data, FULL_PING_RESULT
    if message.message_id != MessageId.FULL_PING_RESULT:
        return Reject("not_a_ping", f"message {message.message_id:#04x}", message.offset)
    if len(data) < layout.size:
        detail = f"{len(data)} bytes, a full ping result has {layout.size} or more"
        return Reject("short_message", detail, message.offset)
    fields = layout.unpack(data)
    rows, beams = fields["rows"], fields["beams"]
    start, size = fields["image_offset"], fields["image_size"]
    if not rows or not beams:
        return Reject("empty", f"an image of {rows} x {beams} samples", message.offset)
    if start + size > len(data) or start < layout.size + 2 * beams:
        detail = f"an image of {size} bytes at byte {start} of {len(data)}"
        return Reject("out_of_bounds", detail, message.offset)
    if fields["message_size"] != len(data):
        detail = f"{len(data)} bytes, the body states {fields['message_size']}"
        return Reject("size_mismatch", detail, message.offset)
    table: NDArray[np.int16] = np.frombuffer(data, np.dtype("<i2"), beams, layout.size)
    bearings_rad = table.astype(np.float64) * CENTIDEGREE_RAD
    bearings_rad.flags.writeable = False
    sample = _SAMPLES.get(size // (rows * beams)) if size % (rows * beams) == 0 else None
    image: NDArray[Any] | None = None
    if sample is not None:
        image = np.frombuffer(data, sample, rows * beams, start).reshape(rows, beams)
    range_m = float(fields["range_m"])
    return FullPing(
        message.arrival_ns,
        message.offset,
        message.source_id,
        range_m if math.isfinite(range_m) else math.nan,
        rows,
        beams,
        bearings_rad,
        image,
        bytes(data[start : start + size]),
    )
