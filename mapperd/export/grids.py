"""The top of the map as an ESRI ASCII grid: QGIS, GDAL and survey programs read it."""

from typing import BinaryIO

import numpy as np

from mapperd.errors import ExportError
from mapperd.export.cells import NO_TOP, Cells

__all__ = ["NO_DATA", "write_ascii_grid"]

NO_DATA = "-9999"


def write_ascii_grid(file: BinaryIO, tops: Cells | None, resolution_m: float) -> None:
    """Write elevations in metres: z up, not a depth, of the centre of each column's top voxel.

    The format has no place for units, axes or a name of the frame: x is east and y north, in
    metres from the map's origin.

    Args:
        file: where to.
        tops: indices of the highest occupied voxels.
        resolution_m: edge of a cell.

    Raises:
        ExportError: there is nothing to write; the format knows no empty grid.
    """
    if tops is None:
        raise ExportError("no occupied voxel: there is no surface to write")
    file.write(_header(tops, resolution_m).encode("ascii"))
    for row in np.flipud(tops.values):  # the first line is the north
        known = row != NO_TOP
        words = np.full(len(row), NO_DATA, dtype=object)
        words[known] = [f"{z:.4f}" for z in ((row[known] + 0.5) * resolution_m).tolist()]
        file.write((" ".join(words.tolist()) + "\n").encode("ascii"))


def _header(tops: Cells, resolution_m: float) -> str:
    window = tops.window
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
