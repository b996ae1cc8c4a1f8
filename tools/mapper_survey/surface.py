"""The sea floor in a map's columns: a depth as hydrographers hand it over, and how sure it is."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mapper_survey.windows import ColumnWindow
from mapperd.export.cells import NO_TOP, indices_of
from mapperd.mapping.sonar_map import Voxels

__all__ = ["CELL_VOXELS", "NO_TOP", "RULES", "Rule", "SurfaceCells", "surface_of", "tops_of"]

Rule = Literal["shoalest", "median"]
RULES: tuple[Rule, ...] = get_args(Rule)

CELL_VOXELS = (1, 2, 4, 8, 16)
"""Columns of voxels along a cell's edge: windows are whole cells."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Cells of a window that hold a surface.

    Attributes:
        row: (N,) of each, 0 in the north.
        column: (N,), 0 in the west.
        z_m: (N,) of the surface, map frame.
        uncertainty_m: (N,) standard deviation.
        count: (N,) pings that observed its best seen voxel.
    """

    row: Ints
    column: Ints
    z_m: Floats
    uncertainty_m: Floats
    count: Ints


def surface_of(
    voxels: Voxels,
    resolution_m: float,
    window: ColumnWindow,
    cell_voxels: int = 1,
    *,
    rule: Rule = "shoalest",
    vertical_uncertainty_m: float = 0.0,
) -> SurfaceCells:
    """Take the surface out of a window's occupied voxels.

    A column's surface is its uppermost occupied voxel and those that follow without a gap below
    it: a sonar's opening angle makes a layer of what is a sheet. What lies under a gap is under
    something, and no sea floor for a ship. Of the voxels of all surfaces in a cell `shoalest`
    takes the highest centre and `median` the middle one (the mean of both where they are even in
    number).

    The uncertainty is u, with the voxels' edge h, their heights z_i and probabilities p_i as
    weights, z the height that is taken, and what is given:

        u^2 = h^2 / 12 + sum p_i (z_i - z)^2 / sum p_i + given^2

    The first term is the variance of a place known to lie in a voxel and no more (GUM, JCGM
    100:2008, 4.3.7); the second the scatter of the evidence about what is handed over, with the
    bias that a choice of the shoalest brings.

    Args:
        voxels: occupied ones of the window.
        resolution_m: edge of a voxel.
        window: where they lie.
        cell_voxels: columns along a cell's edge, one of `CELL_VOXELS`.
        rule: what stands for a cell.
        vertical_uncertainty_m: standard deviation of heights by what the map does not know:
            navigation, tide.
    """
    chosen, index = _layers(voxels, resolution_m, window)
    cells = window.edge // cell_voxels
    column = (index[:, 0] - window.x) // cell_voxels
    row = cells - 1 - (index[:, 1] - window.y) // cell_voxels
    cell = row * cells + column
    order = np.lexsort((index[:, 2], cell))
    cell, chosen, z = cell[order], chosen[order], index[order, 2]
    found, start = np.unique(cell, return_index=True)
    if not len(found):
        return SurfaceCells(found, found, found * resolution_m, found * resolution_m, found)
    end = np.append(start[1:], len(cell))
    if rule == "shoalest":
        middle = z[end - 1].astype(np.float64)
    else:
        middle = (z[(start + end - 1) // 2] + z[(start + end) // 2]) / 2
    weight = voxels.probability[chosen].astype(np.float64)
    off = (z - np.repeat(middle, end - start)) ** 2
    scatter = np.add.reduceat(weight * off, start) / np.add.reduceat(weight, start)
    variance_m2 = (1 / 12 + scatter) * resolution_m**2 + vertical_uncertainty_m**2
    return SurfaceCells(
        found // cells,
        found % cells,
        (middle + 0.5) * resolution_m,
        np.sqrt(variance_m2),
        np.maximum.reduceat(voxels.count[chosen].astype(np.int64), start),
    )


def tops_of(voxels: Voxels, resolution_m: float, window: ColumnWindow) -> Ints:
    """Index in z of the uppermost occupied voxel of each column.

    Returns:
        (edge, edge), row 0 in the north; `NO_TOP` where a column has none.
    """
    tops = np.full((window.edge, window.edge), NO_TOP)
    index = indices_of(voxels.centres_m, resolution_m)
    place = window.edge - 1 - (index[:, 1] - window.y), index[:, 0] - window.x
    np.maximum.at(tops, place, index[:, 2])
    return tops


def _layers(voxels: Voxels, resolution_m: float, window: ColumnWindow) -> tuple[Ints, Ints]:
    """The voxels of the columns' surfaces: their numbers (N,) and indices (N, 3)."""
    index = indices_of(voxels.centres_m, resolution_m)
    column = (index[:, 1] - window.y) * window.edge + index[:, 0] - window.x
    order = np.lexsort((-index[:, 2], column))
    column, z = column[order], index[order, 2]
    begins = np.append(True, column[1:] != column[:-1])[: len(column)]
    gaps = np.cumsum(np.append(False, z[:-1] - z[1:] != 1)[: len(z)] & ~begins)
    at_begin = gaps[begins][np.cumsum(begins) - 1]
    kept = order[gaps == at_begin]
    return kept, index[kept]
