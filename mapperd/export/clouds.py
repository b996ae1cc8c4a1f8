"""Voxels as point clouds: PLY, PCD and XYZ."""

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.difference import MapDifference
from mapperd.mapping.queries import VoxelCloud

__all__ = [
    "POINT",
    "VERTEX",
    "write_difference",
    "write_pcd",
    "write_ply",
    "write_points",
    "write_xyz",
]

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


_DIFFERENCE_FIELDS = [
    *[(axis, "<f8") for axis in "xyz"],
    *[(colour, "u1") for colour in ("red", "green", "blue")],
    ("class", "u1"),
    ("distance", "<f4"),
]
DIFFERENCE_POINT = np.dtype(_DIFFERENCE_FIELDS)
"""One voxel of two compared maps."""

DIFFERENCE_CLASSES = {
    "same": (150, 150, 150),
    "appeared": (30, 160, 60),
    "vanished": (210, 40, 40),
    "not seen before": (120, 200, 250),
    "not seen again": (250, 190, 90),
}
"""Colours by class; the class is its place in this order."""


def write_difference(file: BinaryIO, difference: MapDifference) -> None:
    """Write the voxels of two maps as PLY, coloured by `DIFFERENCE_CLASSES`.

    Voxels that are the same are those of the second map; `distance` is infinite beyond the reach.
    """
    colours = np.array(list(DIFFERENCE_CLASSES.values()), dtype=np.uint8)
    parts = []
    for way, changed, unseen in ((difference.appeared, 1, 3), (difference.vanished, 2, 4)):
        kind = np.where(way.same, 0, np.where(way.seen, changed, unseen))
        kept = kind > 0 if way is difference.vanished else np.ones(len(kind), dtype=np.bool_)
        points = np.empty(int(kept.sum()), dtype=DIFFERENCE_POINT)
        for axis, name in enumerate("xyz"):
            points[name] = way.centres_m[kept, axis]
        for axis, name in enumerate(("red", "green", "blue")):
            points[name] = colours[kind[kept], axis]
        points["class"], points["distance"] = kind[kept], way.distance_m[kept]
        parts.append(points)
    classes = ", ".join(f"{at} {name}" for at, name in enumerate(DIFFERENCE_CLASSES))
    types = {"<f8": "double", "<f4": "float", "u1": "uchar"}
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment mapperd difference within {difference.tolerance_m:.9g} m; class: {classes}",
        f"element vertex {sum(map(len, parts))}",
        *[f"property {types[kind]} {name}" for name, kind in _DIFFERENCE_FIELDS],
        "end_header",
        "",
    ]
    file.write("\n".join(lines).encode("ascii"))
    for points in parts:
        file.write(points.data)


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
