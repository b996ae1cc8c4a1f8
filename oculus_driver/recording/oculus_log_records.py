"""The records of an Oculus Viewer log (`.oculus`, version 1), declared once for both directions.

Little-endian; the padding of the vendor's structures is written out as fields.
"""

from __future__ import annotations

import math
from typing import Final

from oculus_driver.layout import F64, U16, U32, Field, Layout

FILE_MAGIC: Final = 0x11223344
ITEM_MAGIC: Final = 0xAABBCCDD
CONVERTED_MAGIC: Final = 2037
"""Both magics of the files that one converter of ROS bags left behind; sizes in them are 0."""

FILE_HEADER: Final = Layout(
    "log header",
    48,
    (
        Field("magic", 0, U32, default=FILE_MAGIC),
        Field("header_size", 4, U32, default=48),
        Field("source", 8, "16s", default=b"Oculus"),
        Field("version", 24, U16, default=1),
        Field("encryption", 26, U16),
        Field("padding_28", 28, "4s", default=b""),
        Field("key", 32, "q"),
        Field("created_unix_s", 40, F64, default=0.0),
    ),
)

ITEM_HEADER: Final = Layout(
    "log item header",
    40,
    (
        Field("magic", 0, U32, default=ITEM_MAGIC),
        Field("header_size", 4, U32, default=40),
        Field("kind", 8, U16),
        Field("version", 10, U16),
        Field("padding_12", 12, "4s", default=b""),
        Field("unix_s", 16, F64, default=0.0),
        Field("compression", 24, U16),
        Field("padding_26", 26, "2s", default=b""),
        Field("original_size", 28, U32),
        Field("payload_size", 32, U32),
        Field("padding_36", 36, "4s", default=b""),
    ),
)

STAMP: Final = Layout("stamp", 16, (Field("s", 0, "Q"), Field("ns", 8, "Q")))
"""Payload of an ENSTA stamp item: when the message before it came."""

MESSAGE_ITEM: Final = 10
"""Kind of an item that holds one Oculus message, header included."""

STAMP_ITEM: Final = 1010
"""Kind of the item with which ENSTA's recorder stamps the message before it."""

PLAIN: Final = 0
QT_COMPRESSED: Final = 1

NS_PER_S: Final = 1_000_000_000
_LATEST_NS: Final = 1 << 63


def stamp_ns(value: float, units_per_s: int = 1) -> int | None:
    """Return a time since 1970 in nanoseconds, None where it is no time: not positive, too late.

    Seconds as 64-bit floats resolve about 0.2 µs today; whole numbers are kept exactly.
    """
    if not math.isfinite(value) or not 0 < value < _LATEST_NS // NS_PER_S * units_per_s:
        return None
    whole = int(value)
    unit_ns = NS_PER_S // units_per_s
    return whole * unit_ns + round((value - whole) * unit_ns)
