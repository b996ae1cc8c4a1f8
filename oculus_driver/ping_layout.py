"""Layout of a ping: offsets of bearing table, gain words and samples, derived from its sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from oculus_driver.errors import Reject
from oculus_driver.wire import BYTES_PER_SAMPLE, HEADER, FireFlags

if TYPE_CHECKING:
    from oculus_driver.stream import Message
    from oculus_driver.wire import Layout

GAIN_WORD: Final = 4

MAX_DEPTH_M: Final = 1000.0
"""No Oculus has more than 200 m of range; an image that claims more than this is noise."""

MIN_RESOLUTION_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class PingLayout:
    """Offsets inside a ping message, all within its bytes.

    Attributes:
        rows, beams: of the image, both at least 1.
        table_offset: of the bearing table.
        image_offset: of the first row, including its gain word.
        stride: bytes from row to row.
        width: bytes per sample.
        gain_words: whether each row starts with a gain word.
        warnings: size_mismatch, bad_data_size, gain_flag.
    """

    rows: int
    beams: int
    table_offset: int
    image_offset: int
    stride: int
    width: int
    gain_words: bool
    warnings: frozenset[str]


def resolve_layout(
    message: Message, layout: Layout, fields: dict[str, Any], *, deliver_mismatched: bool
) -> PingLayout | Reject:
    """Return the layout of a ping, or why the ping is unusable.

    Args:
        message: a ping result, at least as long as its fixed part.
        layout: wire layout of its version.
        fields: the unpacked fixed part.
        deliver_mismatched: accept contradicting sizes, with a warning.
    """
    mismatched = not _sizes_agree(message, layout, fields)
    fault = _bounds_fault(message, layout, fields) or _resolution_fault(fields)
    if fault is None and mismatched and not deliver_mismatched:
        fault = "size_mismatch"
    rows, beams, image_size = fields["rows"], fields["beams"], fields["image_size"]
    samples = None if fault else _samples(fields["data_size"], image_size, rows, beams)
    odd_width = fields["data_size"] not in BYTES_PER_SAMPLE
    if samples is None:
        return _reject(
            fault or ("bad_data_size" if odd_width else "size_mismatch"), message, fields
        )
    width, gain_words = samples
    warnings = {
        "size_mismatch": mismatched,
        "bad_data_size": odd_width,
        "gain_flag": gain_words != bool(fields["flags"] & FireFlags.SEND_GAIN),
    }
    return PingLayout(
        rows=rows,
        beams=beams,
        table_offset=layout.size,
        image_offset=fields["image_offset"],
        stride=image_size // rows,
        width=width,
        gain_words=gain_words,
        warnings=frozenset(name for name, active in warnings.items() if active),
    )


def _sizes_agree(message: Message, layout: Layout, fields: dict[str, Any]) -> bool:
    """Return whether the three stated sizes agree."""
    stated = HEADER.size + fields["payload_size"]
    image_end = fields["image_offset"] + fields["image_size"]
    agree = fields["message_size"] == stated == image_end == len(message.data)
    return bool(agree and fields["image_offset"] >= layout.size + 2 * fields["beams"])


def _bounds_fault(message: Message, layout: Layout, fields: dict[str, Any]) -> str | None:
    if fields["rows"] == 0 or fields["beams"] == 0:
        return "empty"
    table_end = layout.size + 2 * fields["beams"]
    image_end = fields["image_offset"] + fields["image_size"]
    return "out_of_bounds" if max(table_end, image_end) > len(message.data) else None


def _resolution_fault(fields: dict[str, Any]) -> str | None:
    resolution = fields["range_resolution_m"]
    good = math.isfinite(resolution) and resolution >= MIN_RESOLUTION_M
    return None if good and resolution * fields["rows"] <= MAX_DEPTH_M else "bad_resolution"


def _reject(reason: str, message: Message, fields: dict[str, Any]) -> Reject:
    detail = (
        f"ping {fields['ping_id']}: {fields['rows']} rows of {fields['beams']} beams, "
        f"{fields['range_resolution_m']} m, data size {fields['data_size']}, "
        f"image {fields['image_offset']} + {fields['image_size']} bytes, message "
        f"{fields['message_size']}, header {fields['payload_size']} + {HEADER.size}, "
        f"{len(message.data)} bytes there"
    )
    return Reject(reason, detail, message.offset, fields["ping_id"])


def _samples(data_size: int, image_size: int, rows: int, beams: int) -> tuple[int, bool] | None:
    """Return bytes per sample and whether there are gain words, derived from the size alone.

    The flag bit is ignored: it is wrong in version-2 echoes. If the data size is unknown, a
    combination is accepted if it is the only one that fits.
    """
    stride, remainder = divmod(image_size, rows)
    if remainder:
        return None
    known = BYTES_PER_SAMPLE.get(data_size)
    widths = (1, 2, 3, 4) if known is None else (known,)
    fits = [
        (width, words)
        for width in widths
        for words in (False, True)
        if stride == beams * width + (GAIN_WORD if words else 0)
    ]
    return fits[0] if len(fits) == 1 else None
