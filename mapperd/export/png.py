"""Images as PNG (ISO/IEC 15948): 8 bits, grey or RGB. It saves the vehicle an imaging library."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["png_bytes"]

MAGIC = b"\x89PNG\r\n\x1a\n"
GREY, RGB = 0, 2
NO_FILTER = 0


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """Encode an image.

    Args:
        image: (rows, columns) grey, or (rows, columns, 3); row 0 on top.
    """
    rows, columns = image.shape[:2]
    colour = GREY if image.ndim == 2 else RGB  # noqa: PLR2004 no axis of colours
    lines = np.full((rows, 1 + image[0].size), NO_FILTER, np.uint8)
    lines[:, 1:] = image.reshape(rows, -1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, colour, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 1)), (b"IEND", b""))
    return MAGIC + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    check = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)
