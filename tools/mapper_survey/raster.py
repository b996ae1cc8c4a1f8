"""Pictures of a map from above, a pixel for some columns of voxels, filled window by window."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mapper_survey.windows import Tiling

__all__ = ["MOST_PIXELS", "Raster"]

MOST_PIXELS = 1200
"""Along the longer side; a wider map gets more columns to a pixel."""

MARGIN = 0.03
"""Of what is shown, left empty around it."""

Ints = NDArray[np.int64]


class Raster:
    """What pixels of one picture lie where.

    Args:
        tiling: what the picture shows.
        resolution_m: edge of a voxel.

    Attributes:
        shape: rows and columns.
        extent_m: left, right, bottom and top in the map's frame.
        columns: of voxels, along a pixel's edge.
    """

    def __init__(self, tiling: Tiling, resolution_m: float) -> None:
        width, height = tiling.columns * tiling.edge, tiling.rows * tiling.edge
        self.columns = max(1, math.ceil(max(width, height) / MOST_PIXELS))
        self.shape = math.ceil(height / self.columns), math.ceil(width / self.columns)
        self._x, self._north = tiling.x, tiling.north
        pixel_m = self.columns * resolution_m
        left_m, top_m = tiling.x * resolution_m, tiling.north * resolution_m
        self.extent_m = (
            left_m,
            left_m + self.shape[1] * pixel_m,
            top_m - self.shape[0] * pixel_m,
            top_m,
        )

    def full(self, value: float) -> NDArray[np.float64]:
        """A picture of one number."""
        return np.full(self.shape, value)

    def shown_m(self, seen: NDArray[np.bool_]) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the pixels that show something, and a little around.

        Args:
            seen: of `shape`; one of them at least.
        """
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        left_m, right_m, _, top_m = self.extent_m
        pixel_m = (right_m - left_m) / self.shape[1]
        room_m = MARGIN * max(len(rows), len(columns)) * pixel_m
        return (
            left_m + columns[0] * pixel_m - room_m,
            left_m + (columns[-1] + 1) * pixel_m + room_m,
            top_m - (rows[-1] + 1) * pixel_m - room_m,
            top_m - rows[0] * pixel_m + room_m,
        )

    def put(
        self,
        picture: NDArray[np.float64],
        how: Callable[..., None],
        x: Ints,
        y: Ints,
        values: NDArray[np.generic] | float,
    ) -> None:
        """Put values into a picture by `np.maximum.at` and the like.

        Args:
            picture: of `shape`, row 0 in the north.
            how: joins a value to what is there.
            x: (N,) indices of columns of voxels.
            y: the same northwards.
            values: (N,) numbers, or one.
        """
        how(picture, ((self._north - 1 - y) // self.columns, (x - self._x) // self.columns), values)
