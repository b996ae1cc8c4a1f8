"""Qt's compression: the size before compression, 4 bytes big-endian, then a zlib stream."""

from __future__ import annotations

import struct
import zlib
from typing import Final

from oculus_driver.wire import MAGIC_BYTES, MAX_MESSAGE_SIZE

_SIZE: Final = struct.Struct(">I")


def uncompress(data: bytes) -> bytes | None:
    """Return what was compressed, None if that cannot be told or is larger than any message."""
    return inflate(data[_SIZE.size :])


def inflate(data: bytes) -> bytes | None:
    """Return the content of one whole zlib stream; at most one message's worth is unpacked."""
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(data, MAX_MESSAGE_SIZE)
    except zlib.error:
        return None
    return content if stream.eof else None


def message_bytes(payload: bytes) -> bytes | None:
    """Return the Oculus message in a payload that may be compressed in either way, else None."""
    if payload.startswith(MAGIC_BYTES):
        return payload
    for content in (inflate(payload), uncompress(payload)):
        if content is not None and content.startswith(MAGIC_BYTES):
            return content
    return None
