"""Voxels as point clouds: PLY, PCD and XYZ."""

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.content import VoxelCloud

__all__ = ["POINT", "VERTEX", "write_pcd", "write_ply", "write_points", "write_xyz"]

_PLY_FIELDS = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("probability", "<f4"), ("count", "<u2")]
VERTEX = np.dtype(_PLY_FIELDS)
"""One point; double coordinates, because maps far from the origin lose millimetres in float."""

_PLY_TYPES = {"<f8": "double", "<f4": "float", "<u2": "ushort"}


def write_ply(file: BinaryIO, voxels: VoxelCloud, resolution_m: float) -> None:
    """Write voxel centres (metres; x east, y north, z up) with probability and count."""
    file.write(_ply_header(len(voxels), resolution_m).encode("ascii"))
    for some in voxels.batches():
        vertices = np.empty(len(some), dtype=VERTEX)
        for axis, name in enumerate("xyz"):
            vertices[name] = some.centres_m[:, axis]
        vertices["probability"] = some.probability
        vertices["count"] = some.count
        file.write(vertices.data)


def _ply_header(count: int, resolution_m: float) -> str:
    properties = [f"property {_PLY_TYPES[kind]} {name}" for name, kind in _PLY_FIELDS]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment mapperd occupied voxels, edge {resolution_m:.9g} m",
        "comment voxel centres in metres, x east, y north, z up",
        f"element vertex {count}",
        *properties,
        "end_header",
        "",
    ]
    return "\n".join(lines)


_PCD_FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("count", "<u2")]
POINT = np.dtype(_PCD_FIELDS)
"""One point; PCL's own types hold single floats: within 8 km of the origin to half a millimetre."""


def write_pcd(file: BinaryIO, voxels: VoxelCloud, resolution_m: float) -> None:
    """Write voxel centres (metres; x east, y north, z up); `intensity` is the probability."""
    file.write(_pcd_header(len(voxels), resolution_m).encode("ascii"))
    for some in voxels.batches():
        points = np.empty(len(some), dtype=POINT)
        for axis, name in enumerate("xyz"):
            points[name] = some.centres_m[:, axis]
        points["intensity"] = some.probability
        points["count"] = some.count
        file.write(points.data)


def _pcd_header(count: int, resolution_m: float) -> str:
    kinds = [np.dtype(kind) for _, kind in _PCD_FIELDS]
    lines = [
        f"# .PCD v0.7 - mapperd occupied voxels, edge {resolution_m:.9g} m",
        "VERSION 0.7",
        f"FIELDS {' '.join(name for name, _ in _PCD_FIELDS)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
        "",
    ]
    return "\n".join(lines)


LINES_AT_ONCE = 1000
"""Formatting holds the interpreter for about a millisecond at a time."""


def write_xyz(file: BinaryIO, voxels: VoxelCloud) -> None:
    """Write voxel centres in metres (x east, y north, z up, not a depth), to a tenth of one mm."""
    for some in voxels.batches():
        write_points(file, some.centres_m)


def write_points(
    file: BinaryIO, points: NDArray[np.float64], digits: tuple[int, int, int] = (4, 4, 4)
) -> None:
    """Write three numbers (N, 3) a line, each with so many digits after its point."""
    line = "%.{}f %.{}f %.{}f\n".format(*digits)
    for begin in range(0, len(points), LINES_AT_ONCE):
        some = points[begin : begin + LINES_AT_ONCE]
        lines = line * len(some) % tuple(some.ravel().tolist())
        file.write(lines.encode("ascii"))
