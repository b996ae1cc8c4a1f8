"""Voxels as text, a line `x y z` each: what every program for soundings reads."""

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.sonar_map import Voxels

__all__ = ["write_points", "write_xyz"]

LINES_AT_ONCE = 1000
"""Formatting holds the interpreter for about a millisecond at a time."""


def write_xyz(file: BinaryIO, voxels: Voxels) -> None:
    """Write voxel centres in metres (x east, y north, z up, not a depth), to a tenth of one mm."""
    write_points(file, voxels.centres_m)


def write_points(
    file: BinaryIO, points: NDArray[np.float64], digits: tuple[int, int, int] = (4, 4, 4)
) -> None:
    """Write three numbers (N, 3) a line, each with so many digits after its point."""
    line = "%.{}f %.{}f %.{}f\n".format(*digits)
    for begin in range(0, len(points), LINES_AT_ONCE):
        some = points[begin : begin + LINES_AT_ONCE]
        lines = line * len(some) % tuple(some.ravel().tolist())
        file.write(lines.encode("ascii"))
