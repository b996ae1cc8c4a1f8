"""The map from above as a picture and its YAML: what Nav2's map_server loads (trinary)."""

import json
from typing import BinaryIO

import numpy as np

from mapperd.errors import ExportError
from mapperd.export.cells import Cells

__all__ = ["FREE_THRESH", "GREY", "OCCUPIED_THRESH", "nav2_yaml", "write_pgm"]

GREY = np.array([205, 254, 0], dtype=np.uint8)
"""Of unknown, free and occupied cells, as map servers write them."""

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""A pixel p is read as occupied above the one in (255 - p) / 255, as free below the other.

The often seen 0.25 would make 205, which is 0.19608, free.
"""


def write_pgm(file: BinaryIO, cells: Cells | None) -> None:
    """Write the picture, north on top.

    Raises:
        ExportError: nothing is known; the format has no empty picture.
    """
    if cells is None:
        raise ExportError("nothing is known at these heights: there is no grid to write")
    window = cells.window
    file.write(f"P5\n{window.width} {window.height}\n255\n".encode("ascii"))
    file.write(np.ascontiguousarray(GREY[np.flipud(cells.values)]).data)


def nav2_yaml(image: str, cells: Cells, resolution_m: float) -> bytes:
    """The text beside it; its origin is the picture's lower left corner in the map's frame."""
    window = cells.window
    corner = f"{window.x * resolution_m:.10g}, {window.y * resolution_m:.10g}, 0"
    lines = [
        f"image: {json.dumps(image, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {resolution_m:.10g}",
        f"origin: [{corner}]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESH}",
        f"free_thresh: {FREE_THRESH}",
        "",
    ]
    return "\n".join(lines).encode()
