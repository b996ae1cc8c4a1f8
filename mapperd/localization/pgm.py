"""Grey images as binary .pgm (P5) of 8 bits, which is what map servers write."""

import re

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import MapError
from mapperd.localization.grid_map import MAX_CELLS

__all__ = ["pgm_bytes", "pgm_pixels"]

HEADER = re.compile(
    rb"P5(?:\s|#[^\n]{0,200}\n)+(\d{1,9})(?:\s|#[^\n]{0,200}\n)+(\d{1,9})"
    rb"(?:\s|#[^\n]{0,200}\n)+(\d{1,5})\s"
)
"""Magic, width, height, brightest; comments up to a line's end between them."""

LONGEST_HEADER = 4096
BRIGHTEST = 255


def pgm_pixels(data: bytes, name: str) -> NDArray[np.uint8]:
    """The pixels of a whole file, (height, width), scaled so that white is 255.

    Args:
        data: the file.
        name: what to call it in messages.

    Raises:
        MapError: it is no such image, or not all of one (`bad_map_file`).
    """
    header = HEADER.match(data[:LONGEST_HEADER])
    if header is None:
        raise MapError(f"{name}: no binary grey image (P5)", "bad_map_file")
    width, height, brightest = (int(number) for number in header.groups())
    if not 0 < brightest <= BRIGHTEST:
        raise MapError(
            f"{name}: 8 bits a pixel were expected, not up to {brightest}", "bad_map_file"
        )
    if not 0 < width * height <= MAX_CELLS:
        raise MapError(
            f"{name}: {width} x {height} pixels; allowed: up to {MAX_CELLS}", "bad_map_file"
        )
    if len(data) - header.end() != width * height:
        raise MapError(
            f"{name}: {len(data) - header.end()} bytes of pixels, {width} x {height} were expected",
            "bad_map_file",
        )
    pixels = np.frombuffer(data, np.uint8, offset=header.end()).reshape(height, width)
    if brightest == BRIGHTEST:
        return pixels.copy()
    if int(pixels.max()) > brightest:
        raise MapError(f"{name}: a pixel above its brightest, {brightest}", "bad_map_file")
    scaled: NDArray[np.uint8] = np.rint(pixels * (BRIGHTEST / brightest)).astype(np.uint8)
    return scaled


def pgm_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """The file of pixels (height, width)."""
    height, width = pixels.shape
    return b"P5\n%d %d\n255\n" % (width, height) + np.ascontiguousarray(pixels).tobytes()
