"""The map seen from above, a cell for each column of voxels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import ExportError
from mapperd.mapping.core_args import prior_log_odds
from mapperd.mapping.probability import log_odds_of
from mapperd.mapping.queries import MapContent

__all__ = [
    "FREE",
    "MAX_CELLS",
    "NO_TOP",
    "OCCUPIED",
    "UNKNOWN",
    "GridLayer",
    "GridWindow",
    "Heights",
    "TopStrip",
    "Tops",
    "indices_of",
    "known_cells",
]

MAX_CELLS = 1 << 26
"""Of a grid: two voxels far apart make a huge one, of nothing."""

BLOCKS_AT_ONCE = 256
"""Blocks looked at before other threads may."""

UNKNOWN, FREE, OCCUPIED = 0, 1, 2

NO_TOP = np.iinfo(np.int32).min
"""Index in z of a column without an occupied voxel."""

STRIP_CELLS = 1 << 24
"""Cells of the highest voxels that are in memory at a time."""

SQUARE = 256
"""Cells along an edge of the squares of which a grid of unknown extent is made."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Heights:
    """Which voxels count: those whose centres lie in `min_m <= z <= max_m`."""

    min_m: float = -np.inf
    max_m: float = np.inf


@dataclass(frozen=True, slots=True)
class GridWindow:
    """Columns of voxels: indices of the first in x and y, and how many."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, eq=False)
class GridLayer:
    """One number a column.

    Attributes:
        values: (height, width); row 0 is the south, column 0 the west.
        window: which columns.
    """

    values: NDArray[np.generic]
    window: GridWindow


def window_of(columns: Ints) -> GridWindow:
    """The smallest window of columns (N, 2), N at least 1.

    Raises:
        ExportError: it has over `MAX_CELLS`.
    """
    low, high = columns.min(axis=0), columns.max(axis=0)
    width, height = (int(edge) for edge in high - low + 1)
    if width * height > MAX_CELLS:
        raise ExportError(
            f"a grid of {width} x {height} cells is too large; allowed: {MAX_CELLS} together"
        )
    return GridWindow(int(low[0]), int(low[1]), width, height)


def indices_of(centres_m: NDArray[np.float64], resolution_m: float) -> Ints:
    """Voxels' whole-number places, from their centres."""
    return np.rint(centres_m / resolution_m - 0.5).astype(np.int64)


class KnownCells:
    """What is known of each column: OCCUPIED where one of its voxels is, else FREE where one is.

    Args:
        heights: which voxels count.
        resolution_m: edge of a voxel.
        occupied_log_odds: voxels above are occupied.
        free_log_odds: observed voxels below are free. Both are relative to the prior.
    """

    def __init__(
        self, heights: Heights, resolution_m: float, occupied_log_odds: float, free_log_odds: float
    ) -> None:
        self._heights = heights
        self._resolution_m = resolution_m
        # Log-odds are whole units: above a limit is above its floor, below it below its ceiling.
        self._occupied = math.floor(occupied_log_odds / _core.LOG_ODDS_UNIT)
        self._free = math.ceil(free_log_odds / _core.LOG_ODDS_UNIT)
        self._squares: dict[tuple[int, int], NDArray[np.uint8]] = {}

    def add(
        self, keys: NDArray[np.int32], units: NDArray[np.int32], count: NDArray[np.uint16]
    ) -> None:
        """Look at blocks, as `VoxelMap.visit_blocks` gives them."""
        edge = _core.BLOCK_EDGE
        z_m = (keys[:, 2, None].astype(np.int64) * edge + np.arange(edge) + 0.5) * (
            self._resolution_m
        )
        counts = (z_m >= self._heights.min_m) & (z_m <= self._heights.max_m)
        shape = (len(keys), edge, edge * edge)
        seen = (count.reshape(shape) > 0) & counts[:, :, None]
        units = units.reshape(shape)
        occupied = np.asarray((seen & (units > self._occupied)).any(axis=1))
        free = np.asarray((seen & (units < self._free)).any(axis=1))
        block, column = np.nonzero(occupied | free)
        y, x = np.divmod(column, edge)
        columns = keys[block, :2].astype(np.int64) * edge + np.stack((x, y), axis=1)
        known = np.where(occupied[block, column], OCCUPIED, FREE).astype(np.uint8)
        corners, which = np.unique(columns // SQUARE, axis=0, return_inverse=True)
        for number, corner in enumerate(corners.tolist()):
            inside = which.reshape(-1) == number
            x, y = (columns[inside] - np.multiply(corner, SQUARE)).T
            empty = np.full((SQUARE, SQUARE), UNKNOWN, dtype=np.uint8)
            square = self._squares.setdefault((corner[0], corner[1]), empty)
            np.maximum.at(square, (y, x), known[inside])  # blocks lie over each other

    def cells(self) -> GridLayer | None:
        """The grid of all blocks that were added; None where nothing is known. They are forgotten.

        Raises:
            ExportError: it is too large.
        """
        if not self._squares:
            return None
        window = window_of(np.concatenate([_ends(*item) for item in self._squares.items()]))
        grid = np.full((window.height, window.width), UNKNOWN, dtype=np.uint8)
        for corner in list(self._squares):
            square = self._squares.pop(corner)  # both take the memory of the grid
            (x, y), (last_x, last_y) = _ends(corner, square) - (window.x, window.y)
            from_x, from_y = np.multiply(corner, SQUARE) - (window.x, window.y)
            rows, columns = (
                slice(y - from_y, last_y - from_y + 1),
                slice(x - from_x, last_x - from_x + 1),
            )
            grid[y : last_y + 1, x : last_x + 1] = square[rows, columns]
        return GridLayer(grid, window)


def _ends(corner: tuple[int, int], square: NDArray[np.uint8]) -> Ints:
    """Return the lowest and the highest (x, y) of the known cells of a square."""
    y, x = np.nonzero(square)
    return np.array([(x.min(), y.min()), (x.max(), y.max())]) + np.multiply(corner, SQUARE)


def known_cells(sonar_map: MapContent, heights: Heights) -> GridLayer | None:
    """What is known of each column, by the thresholds of the map's settings; None if nothing is.

    Pings wait only while the map is copied.

    Raises:
        ExportError: the grid is too large.
    """
    config = sonar_map.config
    prior = prior_log_odds(config)
    known = KnownCells(
        heights,
        sonar_map.resolution_m,
        log_odds_of(config.occupied_threshold, "occupied_threshold") - prior,
        log_odds_of(config.free_threshold, "free_threshold") - prior,
    )
    for part in sonar_map.parts():
        part.visit_blocks(known.add, BLOCKS_AT_ONCE)
    return known.cells()


@dataclass(frozen=True, slots=True, eq=False)
class TopStrip:
    """Rows of a grid of the highest occupied voxel of each column.

    Attributes:
        z: (rows, width) int32, index of the voxel in z, `NO_TOP` for empty cells; row 0 is the
            north.
        count: (rows, width) uint16, number of pings that observed it.
    """

    z: NDArray[np.int32]
    count: NDArray[np.uint16]


class Tops:
    """The highest occupied voxel of each column, some rows in memory at a time.

    Args:
        sonar_map: the map; every strip reads it again.
        heights: which voxels count.

    Raises:
        ExportError: the grid is too large.

    Attributes:
        window: which columns; None where no voxel counts.
    """

    def __init__(self, sonar_map: MapContent, heights: Heights) -> None:
        self._voxels = sonar_map.occupied()
        self._heights = heights
        self._resolution_m = sonar_map.resolution_m
        corners = [(places.min(axis=0), places.max(axis=0)) for places, _ in self._chosen()]
        columns = np.concatenate(corners).reshape(-1, 3)[:, :2] if corners else None
        self.window = None if columns is None else window_of(columns)

    def strips(self, rows: int) -> Iterator[TopStrip]:
        """Yield the grid from the north.

        Args:
            rows: the height of each strip but the last is a multiple of it.
        """
        window = self.window
        if window is None:
            return
        height = max(STRIP_CELLS // window.width // rows, 1) * rows
        for end in range(window.height, 0, -height):
            yield self._strip(window, max(end - height, 0), end)

    def _strip(self, window: GridWindow, begin: int, end: int) -> TopStrip:
        """Return the rows from `begin` to `end`, counted from the south."""
        z = np.full((end - begin, window.width), NO_TOP, dtype=np.int32)
        count = np.zeros(z.shape, dtype=np.uint16)
        for places, observed in self._chosen():
            rows = end - 1 - (places[:, 1] - window.y)
            inside = (rows >= 0) & (rows < end - begin)
            cells = rows[inside], places[inside, 0] - window.x
            height, seen = places[inside, 2], observed[inside]
            np.maximum.at(z, cells, height)
            top = z[cells] == height
            count[cells[0][top], cells[1][top]] = seen[top]
        return TopStrip(z, count)

    def _chosen(self) -> Iterator[tuple[Ints, NDArray[np.uint16]]]:
        """Yield the indices (N, 3) and counts (N,) of the voxels that count."""
        for some in self._voxels.batches():
            z_m = some.centres_m[:, 2]
            counts = (z_m >= self._heights.min_m) & (z_m <= self._heights.max_m)
            if counts.any():
                yield indices_of(some.centres_m[counts], self._resolution_m), some.count[counts]
