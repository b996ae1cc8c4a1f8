"""Voxels as text, a line `x y z` each: what every program for soundings reads."""

from typing import BinaryIO

from mapperd.mapping import Voxels

__all__ = ["write_xyz"]

LINES_AT_ONCE = 1000
"""Formatting holds the interpreter for about a millisecond at a time."""


def write_xyz(file: BinaryIO, voxels: Voxels) -> None:
    """Write voxel centres in metres (x east, y north, z up, not a depth), to a tenth of one mm."""
    for begin in range(0, len(voxels), LINES_AT_ONCE):
        points = voxels.centres_m[begin : begin + LINES_AT_ONCE]
        lines = "%.4f %.4f %.4f\n" * len(points) % tuple(points.ravel().tolist())
        file.write(lines.encode("ascii"))
