"""Coverage of the ground by each dive, overlaps of dives, and their differences."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapper_survey.surface import NO_TOP, tops_of
from mapper_survey.tally import Tally
from mapper_survey.windows import ColumnWindow, Tiling, WindowedMap
from mapperd.export.cells import UNKNOWN, Heights, known_cells
from mapperd.export.geotiff import NO_DATA, RasterBand
from mapperd.mapping.sonar_map import SonarMap

__all__ = ["BANDS", "MAX_PIXELS", "Coverage", "Pictures", "Raster", "cover"]


MAX_PIXELS = 1200
"""Maximum pixels along the longer side; a wider map has more columns per pixel."""

MARGIN = 0.03
"""Empty margin around the content, as a share of it."""

Ints = NDArray[np.int64]


class Raster:
    """Positions of the pixels of a picture.

    Args:
        tiling: area of the picture.
        resolution_m: edge of a voxel.

    Attributes:
        shape: rows and columns.
        extent_m: left, right, bottom and top in the map's frame.
        columns: columns of voxels along a pixel's edge.
    """

    def __init__(self, tiling: Tiling, resolution_m: float) -> None:
        width, height = tiling.columns * tiling.edge, tiling.rows * tiling.edge
        self.columns = max(1, math.ceil(max(width, height) / MAX_PIXELS))
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
        """Return a picture filled with one number."""
        return np.full(self.shape, value)

    def shown_m(self, seen: NDArray[np.bool_]) -> tuple[float, float, float, float]:
        """Return left, right, bottom and top of the set pixels, with a margin.

        Args:
            seen: mask of `shape`, at least one set.
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
        """Combine values into a picture with `np.maximum.at` or similar.

        Args:
            picture: array of `shape`, row 0 in the north.
            how: combines a value with the existing one.
            x: (N,) indices of columns of voxels, eastwards.
            y: (N,) the same, northwards.
            values: (N,) numbers, or one.
        """
        how(picture, ((self._north - 1 - y) // self.columns, (x - self._x) // self.columns), values)


BANDS = (
    RasterBand("dives that have a surface in the cell"),
    RasterBand("highest less lowest of their surfaces", "m"),
)

Floats32 = NDArray[np.float32]


@dataclass(slots=True)
class Coverage:
    """Counts of columns of voxels, and of differences in height, in voxels.

    Attributes:
        observed: columns that a dive observed, by dive.
        mapped: columns with a surface of the dive.
        alone: columns with a surface of this dive only.
        by_dives: columns by the number of dives with a surface.
        merged: columns with a surface in the merged map.
        spread: highest minus lowest surface where several dives have one.
        dz: surface of the first dive minus that of the second.
    """

    observed: dict[str, int]
    mapped: dict[str, int]
    alone: dict[str, int]
    by_dives: Tally = field(default_factory=Tally)
    merged: int = 0
    spread: Tally = field(default_factory=Tally)
    dz: dict[tuple[str, str], Tally] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Pictures by `Raster`; NaN where empty.

    Attributes:
        z_m: highest surface of the merged map.
        observed: 1 where a dive observed.
        dives: maximum number of dives with a surface in a column.
        spread_m: maximum spread.
        compared: number of compared voxels.
        missing: number of those without one of the other dive within the tolerance.
    """

    z_m: NDArray[np.float64]
    observed: NDArray[np.float64]
    dives: NDArray[np.float64]
    spread_m: NDArray[np.float64]
    compared: NDArray[np.float64]
    missing: NDArray[np.float64]

    @classmethod
    def empty(cls, raster: Raster) -> "Pictures":
        """Return empty pictures."""
        nothing = -np.inf
        return cls(
            raster.full(nothing),
            raster.full(0.0),
            raster.full(0.0),
            raster.full(nothing),
            raster.full(0.0),
            raster.full(0.0),
        )


def cover(
    stores: Mapping[str, WindowedMap],
    merged: WindowedMap,
    tiling: Tiling,
    coverage: Coverage,
    pictures: Pictures,
    *,
    raster: Raster,
    progress: Callable[[], None],
) -> Iterator[Floats32 | None]:
    """Process all columns, window by window; one dive's window is in memory at a time.

    Yields:
        tiles (edge, edge, 2) of `BANDS`, in the tiling's order; None without a surface.
    """
    for window in tiling:
        tops = {}
        for name, stored in stores.items():
            part = stored.columns(window)
            if part is not None:
                tops[name] = _look(part, window, name, coverage, (raster, pictures))
        of_merged = merged.columns(window)
        if of_merged is not None:
            coverage.merged += _draw_merged(of_merged, window, raster, pictures)
        progress()
        yield _together(tops, merged.resolution_m, window, coverage, (raster, pictures))


def _look(
    part: SonarMap,
    window: ColumnWindow,
    name: str,
    coverage: Coverage,
    drawing: tuple[Raster, Pictures],
) -> Ints:
    """One dive in a window: indices of its surface."""
    raster, pictures = drawing
    known = known_cells(part, Heights())
    if known is not None:
        row, column = np.nonzero(known.values != UNKNOWN)
        coverage.observed[name] += len(row)
        raster.put(
            pictures.observed,
            np.maximum.at,
            column + known.window.x,
            row + known.window.y,
            1.0,
        )
    tops = tops_of(part.voxels("occupied"), part.resolution_m, window)
    coverage.mapped[name] += int((tops != NO_TOP).sum())
    return tops


def _draw_merged(part: SonarMap, window: ColumnWindow, raster: Raster, pictures: Pictures) -> int:
    tops = tops_of(part.voxels("occupied"), part.resolution_m, window)
    x, y, chosen = _places(tops != NO_TOP, window)
    z_m = (tops[chosen] + 0.5) * part.resolution_m
    raster.put(pictures.z_m, np.maximum.at, x, y, z_m)
    return len(x)


def _together(
    tops: Mapping[str, Ints],
    resolution_m: float,
    window: ColumnWindow,
    coverage: Coverage,
    drawing: tuple[Raster, Pictures],
) -> Floats32 | None:
    """All dives in a window."""
    raster, pictures = drawing
    if not tops:
        return None
    has = {name: of != NO_TOP for name, of in tops.items()}
    dives: Ints = np.stack(list(has.values())).sum(axis=0, dtype=np.int64)
    if not dives.any():
        return None
    coverage.by_dives.add(dives[dives > 0])
    for name, mask in has.items():
        coverage.alone[name] += int((mask & (dives == 1)).sum())
    for (a, b), tally in coverage.dz.items():
        if a in tops and b in tops:
            both = has[a] & has[b]
            tally.add(tops[a][both] - tops[b][both])
    highest: Ints = np.stack(list(tops.values())).max(axis=0)
    lows = [np.where(has[name], of, highest) for name, of in tops.items()]
    lowest: Ints = np.stack(lows).min(axis=0)
    several = dives > 1
    coverage.spread.add((highest - lowest)[several])
    x, y, at = _places(dives > 0, window)
    raster.put(pictures.dives, np.maximum.at, x, y, dives[at])
    x, y, at = _places(several, window)
    raster.put(pictures.spread_m, np.maximum.at, x, y, (highest - lowest)[at] * resolution_m)
    tile = np.full((*dives.shape, len(BANDS)), NO_DATA, dtype=np.float32)
    tile[dives > 0, 0] = dives[dives > 0]
    tile[several, 1] = (highest - lowest)[several] * resolution_m
    return tile


def _places(
    mask: NDArray[np.bool_], window: ColumnWindow
) -> tuple[Ints, Ints, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return indices in x and y of selected columns, and their rows and columns."""
    row, column = np.nonzero(mask)
    return window.x + column, window.y + window.edge - 1 - row, (row, column)
