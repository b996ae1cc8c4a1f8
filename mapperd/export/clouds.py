"""Voxels as a PLY point cloud, binary little endian: CloudCompare, MeshLab and Blender read it."""

from typing import BinaryIO

import numpy as np

from mapperd.mapping.sonar_map import Voxels

__all__ = ["VERTEX", "write_ply"]

_FIELDS = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("probability", "<f4"), ("count", "<u2")]
VERTEX = np.dtype(_FIELDS)
"""One point; double coordinates, because maps far from the origin lose millimetres in float."""

_PLY_TYPES = {"<f8": "double", "<f4": "float", "<u2": "ushort"}


def write_ply(file: BinaryIO, voxels: Voxels, resolution_m: float) -> None:
    """Write voxel centres (metres; x east, y north, z up) with probability and count."""
    file.write(_header(len(voxels), resolution_m).encode("ascii"))
    vertices = np.empty(len(voxels), dtype=VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = voxels.centres_m[:, axis]
    vertices["probability"] = voxels.probability
    vertices["count"] = voxels.count
    file.write(vertices.data)


def _header(count: int, resolution_m: float) -> str:
    properties = [f"property {_PLY_TYPES[kind]} {name}" for name, kind in _FIELDS]
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
