"""Read the voxels of a map from its PLY file."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_DTYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
}
END = b"end_header\n"


@dataclass(frozen=True, slots=True, eq=False)
class VoxelCloud:
    """Occupied voxels.

    Attributes:
        centres_m: (N, 3), map frame.
        edge_m: of one voxel.
    """

    centres_m: NDArray[np.float64]
    edge_m: float


def read_voxels(path: Path) -> VoxelCloud:
    """Read a binary PLY of voxel centres, whose comment says the voxels' edge.

    Raises:
        ValueError: it is no such file.
    """
    data = path.read_bytes()
    head, mark, body = data.partition(END)
    lines = head.decode("ascii", "replace").splitlines()
    if not mark or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise ValueError(f"{path}: not a binary little-endian PLY")
    count = re.search(r"^element vertex (\d+)$", "\n".join(lines), re.MULTILINE)
    edge = re.search(r"edge (\S+) m", "\n".join(lines))
    if count is None or edge is None:
        raise ValueError(f"{path}: says neither how many voxels nor how large they are")
    fields = [line.split()[1:] for line in lines if line.startswith("property ")]
    dtype = np.dtype([(name, _DTYPES[kind]) for kind, name in fields])
    vertices = np.frombuffer(body, dtype, int(count[1]))
    centres = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    return VoxelCloud(centres, float(edge[1]))
