"""Voxels as a PCD point cloud, binary: PCL, ROS tools and Foxglove read it."""

from typing import BinaryIO

import numpy as np

from mapperd.mapping.sonar_map import Voxels

__all__ = ["POINT", "write_pcd"]

_FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("count", "<u2")]
POINT = np.dtype(_FIELDS)
"""One point; PCL's own types hold single floats: within 8 km of the origin to half a millimetre."""


def write_pcd(file: BinaryIO, voxels: Voxels, resolution_m: float) -> None:
    """Write voxel centres (metres; x east, y north, z up); `intensity` is the probability."""
    file.write(_header(len(voxels), resolution_m).encode("ascii"))
    points = np.empty(len(voxels), dtype=POINT)
    for axis, name in enumerate("xyz"):
        points[name] = voxels.centres_m[:, axis]
    points["intensity"] = voxels.probability
    points["count"] = voxels.count
    file.write(points.data)


def _header(count: int, resolution_m: float) -> str:
    kinds = [np.dtype(kind) for _, kind in _FIELDS]
    lines = [
        f"# .PCD v0.7 - mapperd occupied voxels, edge {resolution_m:.9g} m",
        "VERSION 0.7",
        f"FIELDS {' '.join(name for name, _ in _FIELDS)}",
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
