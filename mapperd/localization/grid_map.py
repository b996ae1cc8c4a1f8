"""A planar map: what is free, occupied or unknown, cell by cell."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["FREE", "MAX_CELLS", "OCCUPIED", "UNKNOWN", "GridMap"]

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

MAX_CELLS = 1 << 27
"""Of a map: 134 million, 1.1 km x 1.1 km of 0.1 m cells."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Cells in rows along x, row upon row along y, in a frame that may be turned in the map.

    Attributes:
        occupancy: (rows, columns) int8, read-only: -1 unknown, 0 free, 100 occupied; between them,
            of maps that know it, percent.
        resolution_m: edge of a cell.
        origin_x_m, origin_y_m, origin_yaw_rad: the outer corner of cell [0, 0] in the map frame.

    Raises:
        ValueError: no cells or too many, other values, or numbers that are not finite.
    """

    occupancy: NDArray[np.int8]
    resolution_m: float
    origin_x_m: float = 0.0
    origin_y_m: float = 0.0
    origin_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        """Own the cells, so that nobody can change them afterwards."""
        cells = np.array(self.occupancy, dtype=np.int8, order="C")
        if cells.ndim != 2 or not 0 < cells.size <= MAX_CELLS:  # noqa: PLR2004 rows and columns
            raise ValueError(f"a map has rows and columns, at most {MAX_CELLS} cells")
        if cells.min() < UNKNOWN or cells.max() > OCCUPIED:
            raise ValueError("cells are -1 for unknown, or 0 to 100")
        origin = (self.origin_x_m, self.origin_y_m, self.origin_yaw_rad)
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise ValueError("a cell's edge is above 0 m")
        if not all(map(math.isfinite, origin)):
            raise ValueError("the origin is finite")
        cells.setflags(write=False)
        for name in ("resolution_m", "origin_x_m", "origin_y_m", "origin_yaw_rad"):
            object.__setattr__(self, name, float(getattr(self, name)))
        object.__setattr__(self, "occupancy", cells)

    @property
    def has_free_cells(self) -> bool:
        """Whether a vehicle can be anywhere on it."""
        return bool((self.occupancy == FREE).any())

    def centres_m(self, row: NDArray[np.integer], column: NDArray[np.integer]) -> Floats:
        """(N, 2) centres of cells in the map frame."""
        c, s = math.cos(self.origin_yaw_rad), math.sin(self.origin_yaw_rad)
        x = (np.asarray(column) + 0.5) * self.resolution_m
        y = (np.asarray(row) + 0.5) * self.resolution_m
        return np.stack([self.origin_x_m + c * x - s * y, self.origin_y_m + s * x + c * y], axis=-1)

    def cells_at(self, points_m: Floats) -> NDArray[np.int8]:
        """Values (N,) at points (N, 2) of the map frame; unknown off the map and at NaN."""
        c, s = math.cos(self.origin_yaw_rad), math.sin(self.origin_yaw_rad)
        x, y = points_m[:, 0] - self.origin_x_m, points_m[:, 1] - self.origin_y_m
        column = np.floor((c * x + s * y) / self.resolution_m)
        row = np.floor((-s * x + c * y) / self.resolution_m)
        rows, columns = self.occupancy.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        values = np.full(len(points_m), UNKNOWN, dtype=np.int8)
        values[inside] = self.occupancy[row[inside].astype(int), column[inside].astype(int)]
        return values
