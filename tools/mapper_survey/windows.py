"""Reads a map's file window by window, in the memory of one window."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import BRICK_VOXELS, StoreReader

__all__ = ["WINDOW_BRICKS", "ColumnWindow", "Key", "Tiling", "WindowedMap", "tiling_of"]

WINDOW_BRICKS = 2
"""Bricks along an edge of a window: 12.8 m in a map of 10 cm."""

Key = tuple[int, int, int]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ColumnWindow:
    """Some columns of voxels.

    Attributes:
        x: index of the westernmost column.
        y: index of the southernmost one.
        edge: columns along each side.
        z: keys of the lowest and the highest brick in it; None without bricks.
    """

    x: int
    y: int
    edge: int
    z: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Tiling:
    """Windows that cover maps as a rectangle.

    Attributes:
        x: index of the westernmost column of voxels.
        north: index after the northernmost one.
        edge: columns along each side of a window.
        columns: windows from west to east.
        rows: windows from north to south.
        heights: keys of the lowest and the highest brick, by column and row of the window.
    """

    x: int
    north: int
    edge: int
    columns: int
    rows: int
    heights: Mapping[tuple[int, int], tuple[int, int]]

    def __iter__(self) -> Iterator[ColumnWindow]:
        """Iterate from north to south, in each row from west to east."""
        for row in range(self.rows):
            for column in range(self.columns):
                yield ColumnWindow(
                    self.x + column * self.edge,
                    self.north - (row + 1) * self.edge,
                    self.edge,
                    self.heights.get((column, row)),
                )


class WindowedMap:
    """The file of a map, open for reading; a context manager.

    Args:
        path: the file.
        config: its thresholds count; grid and rule are those of the file.

    Raises:
        StoreError: it cannot be read.

    Attributes:
        config: the combined settings.
        keys: (N, 3) int64, keys of all bricks, ascending.
    """

    def __init__(self, path: Path, config: Config | None = None) -> None:
        self.path = path
        with ExitStack() as opening:
            self._reader = opening.enter_context(StoreReader(path))
            self.config = with_values(config or Config(), self._reader.kind())
            self.keys = self._reader.keys()
            self._open = opening.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""
        return self.config.octree.voxel_resolution

    def part(self, low: Key, high: Key) -> SonarMap:
        """Return the bricks of a box, corners included, as a separate map.

        Raises:
            StoreError: one of them is damaged (`damaged`): a hole would look like water.
        """
        sonar_map = SonarMap(self.config)
        lost = self._reader.load_box(sonar_map, low, high)
        if lost:
            raise StoreError(
                f"{self.path}: {len(lost)} bricks of it are damaged; holes would look like water: "
                "merge the survey again",
                "damaged",
            )
        return sonar_map

    def box(self, low: Ints, high: Ints) -> SonarMap | None:
        """Return the same with keys as arrays (3,); None without bricks.

        Raises:
            StoreError: as `part`.
        """
        begin, end = np.searchsorted(self.keys[:, 0], (low[0], high[0] + 1))
        slab = self.keys[begin:end]
        if not ((slab >= low) & (slab <= high)).all(axis=1).any():
            return None
        (x, y, z), (far_x, far_y, far_z) = low.tolist(), high.tolist()
        return self.part((x, y, z), (far_x, far_y, far_z))

    def columns(self, window: ColumnWindow) -> SonarMap | None:
        """Return the content of a window over its whole height; None if empty.

        Raises:
            StoreError: as `part`.
        """
        if window.z is None:
            return None
        more = window.edge // BRICK_VOXELS - 1
        low = np.array([window.x // BRICK_VOXELS, window.y // BRICK_VOXELS, window.z[0]])
        return self.box(low, np.array([low[0] + more, low[1] + more, window.z[1]]))


def tiling_of(keys: Ints, bricks: int = WINDOW_BRICKS) -> Tiling:
    """Return windows whose corners are multiples of their size.

    Args:
        keys: (N, 3) keys of bricks, N at least 1.
        bricks: bricks along an edge of a window.
    """
    of_bricks = keys[:, :2] // bricks
    (west, south), (east, north) = of_bricks.min(axis=0).tolist(), of_bricks.max(axis=0).tolist()
    heights: dict[tuple[int, int], tuple[int, int]] = {}
    for (x, y), z in zip(of_bricks.tolist(), keys[:, 2].tolist(), strict=True):
        low, high = heights.get((x - west, north - y), (z, z))
        heights[x - west, north - y] = min(low, z), max(high, z)
    edge = bricks * BRICK_VOXELS
    return Tiling(
        west * edge, (north + 1) * edge, edge, east - west + 1, north - south + 1, heights
    )
