"""The sea floor in a map's columns: depths and uncertainties for hydrography."""

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
"""Allowed columns of voxels along a cell's edge; windows consist of whole cells."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Cells of a window with a surface.

    Attributes:
        row: (N,) rows, 0 in the north.
        column: (N,) columns, 0 in the west.
        z_m: (N,) heights of the surface, map frame.
        uncertainty_m: (N,) standard deviations.
        count: (N,) maximum number of pings that observed one of its voxels.
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
    """Extract the surface from a window's occupied voxels.

    A column's surface is its uppermost occupied voxel and those directly below it without a gap,
    because the aperture thickens surfaces to layers. Voxels below a gap lie under something and
    are no sea floor for a ship. Of all surface voxels in a cell `shoalest` uses the highest centre
    and `median` the middle one (the mean of both middle ones for an even number).

    The uncertainty is u, with the voxels' edge h, their heights z_i, probabilities p_i as weights,
    the chosen height z, and the given uncertainty:

        u^2 = h^2 / 12 + sum p_i (z_i - z)^2 / sum p_i + given^2

    The first term is the variance of a position known only to lie in a voxel (GUM, JCGM 100:2008,
    4.3.7); the second is the scatter of the evidence about the chosen height, including the bias
    of the shoalest.

    Args:
        voxels: occupied voxels of the window.
        resolution_m: edge of a voxel.
        window: the window.
        cell_voxels: columns along a cell's edge, one of `CELL_VOXELS`.
        rule: how a cell's height is chosen.
        vertical_uncertainty_m: standard deviation of heights due to navigation and tide.
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
    """Return the index in z of the uppermost occupied voxel of each column.

    Returns:
        (edge, edge), row 0 in the north; `NO_TOP` for empty columns.
    """
    tops = np.full((window.edge, window.edge), NO_TOP)
    index = indices_of(voxels.centres_m, resolution_m)
    place = window.edge - 1 - (index[:, 1] - window.y), index[:, 0] - window.x
    np.maximum.at(tops, place, index[:, 2])
    return tops


def _layers(voxels: Voxels, resolution_m: float, window: ColumnWindow) -> tuple[Ints, Ints]:
    """Return the voxels of the columns' surfaces: numbers (N,) and indices (N, 3)."""
    index = indices_of(voxels.centres_m, resolution_m)
    column = (index[:, 1] - window.y) * window.edge + index[:, 0] - window.x
    order = np.lexsort((-index[:, 2], column))
    column, z = column[order], index[order, 2]
    begins = np.append(True, column[1:] != column[:-1])[: len(column)]
    gaps = np.cumsum(np.append(False, z[:-1] - z[1:] != 1)[: len(z)] & ~begins)
    at_begin = gaps[begins][np.cumsum(begins) - 1]
    kept = order[gaps == at_begin]
    return kept, index[kept]
