"""A cloud of voxels seen along one axis: a grid of pixels, each coloured by a height."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_PIXELS", "View", "project"]

MAX_PIXELS = 1500
"""Along one side of a view; a longer map gets several voxels to the pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A map seen along one axis.

    Attributes:
        height_m: (rows, columns) float64, NaN where no voxel is; the highest voxel of each pixel.
        extent_m: left, right, bottom, top of the grid in the map frame.
    """

    height_m: NDArray[np.float64]
    extent_m: tuple[float, float, float, float]


def project(centres_m: NDArray[np.float64], resolution_m: float, across: int, up: int) -> View:
    """Project voxels so that each is drawn as a square of its true size.

    Args:
        centres_m: (N, 3) voxel centres, N at least 1.
        resolution_m: voxel edge.
        across: axis (0, 1, 2) that runs to the right.
        up: axis that runs upwards.
    """
    plane = centres_m[:, [across, up]]
    low = plane.min(axis=0) - resolution_m / 2
    cells = np.floor((plane - low) / resolution_m).astype(np.int64)
    scale = 1 + cells.max(axis=0) // MAX_PIXELS  # each axis alone: a long map may be thin
    columns, rows = (cells // scale).T
    width, height = int(columns.max()) + 1, int(rows.max()) + 1
    grid = np.full(width * height, -np.inf)
    np.maximum.at(grid, rows * width + columns, centres_m[:, 2])
    grid[np.isneginf(grid)] = np.nan
    left, bottom = (float(edge) for edge in low)
    pixel_m = scale * resolution_m
    right, top = left + width * float(pixel_m[0]), bottom + height * float(pixel_m[1])
    return View(grid.reshape(height, width), (left, right, bottom, top))
