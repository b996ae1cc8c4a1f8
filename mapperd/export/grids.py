"""The map from above as a grid: ESRI ASCII, and Nav2's picture with YAML."""

import json
from typing import BinaryIO

import numpy as np

from mapperd.errors import ExportError
from mapperd.export.cells import NO_TOP, GridLayer, GridWindow, Tops

__all__ = [
    "FREE_THRESH",
    "GREY",
    "NO_DATA",
    "OCCUPIED_THRESH",
    "nav2_yaml",
    "write_ascii_grid",
    "write_pgm",
]

NO_DATA = "-9999"

ROWS_AT_ONCE = 256
"""Rows of a picture that are made at a time."""


def write_ascii_grid(file: BinaryIO, tops: Tops, resolution_m: float) -> None:
    """Write elevations in metres: z up, not a depth, of the centre of each column's top voxel.

    The format has no place for units, axes or a name of the frame: x is east and y north, in
    metres from the map's origin.

    Args:
        file: where to.
        tops: highest occupied voxels.
        resolution_m: edge of a cell.

    Raises:
        ExportError: there is nothing to write; the format knows no empty grid.
    """
    if tops.window is None:
        raise ExportError("no occupied voxel: there is no surface to write")
    file.write(_header(tops.window, resolution_m).encode("ascii"))
    for strip in tops.strips(1):
        for row in strip.z:  # the first line is the north
            known = row != NO_TOP
            words = np.full(len(row), NO_DATA, dtype=object)
            words[known] = [f"{z:.4f}" for z in ((row[known] + 0.5) * resolution_m).tolist()]
            file.write((" ".join(words.tolist()) + "\n").encode("ascii"))


def _header(window: GridWindow, resolution_m: float) -> str:
    lines = [
        f"ncols {window.width}",
        f"nrows {window.height}",
        f"xllcorner {window.x * resolution_m:.10g}",
        f"yllcorner {window.y * resolution_m:.10g}",
        f"cellsize {resolution_m:.10g}",
        f"NODATA_value {NO_DATA}",
        "",
    ]
    return "\n".join(lines)


GREY = np.array([205, 254, 0], dtype=np.uint8)
"""Of unknown, free and occupied cells, as map servers write them."""

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""A pixel p is read as occupied above the one in (255 - p) / 255, as free below the other.

The often seen 0.25 would make 205, which is 0.19608, free.
"""


def write_pgm(file: BinaryIO, cells: GridLayer | None) -> None:
    """Write the picture, north on top.

    Raises:
        ExportError: nothing is known; the format has no empty picture.
    """
    if cells is None:
        raise ExportError("nothing is known at these heights: there is no grid to write")
    window = cells.window
    file.write(f"P5\n{window.width} {window.height}\n255\n".encode("ascii"))
    from_north = cells.values[::-1]
    file.writelines(
        GREY[from_north[row : row + ROWS_AT_ONCE]].tobytes()
        for row in range(0, window.height, ROWS_AT_ONCE)
    )


def nav2_yaml(image: str, cells: GridLayer, resolution_m: float) -> bytes:
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
