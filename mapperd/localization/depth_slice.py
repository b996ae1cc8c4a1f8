"""A planar map out of the 3D one: what a level beam can meet at a depth.

A ping knows no elevations: a beam hears the nearest structure anywhere in its vertical aperture. So
a cell of the slice is occupied where any voxel of the band is that the beam covers.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import MapError
from mapperd.localization.grid_map import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridMap
from mapperd.mapping.queries import FREE as VOXEL_FREE
from mapperd.mapping.queries import OCCUPIED as VOXEL_OCCUPIED
from mapperd.mapping.queries import MapQueries

__all__ = ["beam_band_m", "depth_slice"]

VOXELS_AT_ONCE = 1 << 24

Floats = NDArray[np.float64]


def beam_band_m(
    sonar_z_m: float, range_m: float, vertical_aperture_rad: float, tilt_down_rad: float = 0.0
) -> tuple[float, float]:
    """Lowest and highest that a beam covers on its way to a range, map frame.

    Args:
        sonar_z_m: height of the sonar in the map.
        range_m: slant.
        vertical_aperture_rad: full.
        tilt_down_rad: of the fan's plane, mounting and pitch together.
    """
    half = vertical_aperture_rad / 2
    sines = [math.sin(-tilt_down_rad + e) for e in (-half, half)]
    heights = [0.0, *(range_m * sine for sine in sines)]
    return sonar_z_m + min(heights), sonar_z_m + max(heights)


def depth_slice(queries: MapQueries, low_m: Floats, high_m: Floats) -> GridMap:
    """The union over a box's height.

    A cell is occupied where one of its voxels is, free where none is and one is free, else unknown.

    Args:
        queries: to the 3D map.
        low_m: (3,) corner, map frame; its z and that of the other corner are the band.
        high_m: (3,) corner. The slice has the columns whose centres lie in low <= centre < high.

    Raises:
        MapError: corners that are not finite or not in order, no column, or too many (`bad_slice`).
    """
    low, high = (np.array(corner, dtype=np.float64) for corner in (low_m, high_m))
    resolution_m = queries.resolution_m
    if low.shape != (3,) or high.shape != (3,) or not np.isfinite([low, high]).all():
        raise MapError("a slice has two finite corners of three numbers", "bad_slice")
    size = (high - low) / resolution_m
    if not ((size > 0).all() and (size[0] + 1) * (size[1] + 1) <= MAX_CELLS):
        raise MapError(f"a slice has corners in order, up to {MAX_CELLS} columns", "bad_slice")
    layers = max(1, int(VOXELS_AT_ONCE / max(1.0, (size[0] + 1) * (size[1] + 1))))
    cells: NDArray[np.int8] | None = None
    first_m = low
    for start in np.arange(low[2], high[2], layers * resolution_m):
        corner = np.array([high[0], high[1], min(start + layers * resolution_m, high[2])])
        box = queries.classify_box([low[0], low[1], start], corner)
        if box.values.size == 0:
            continue
        first_m = box.first_centre_m
        part = _union(box.values)
        cells = part if cells is None else np.maximum(cells, part)
    if cells is None:
        raise MapError("no voxel's centre lies in the slice", "bad_slice")
    corner_m = first_m - resolution_m / 2
    return GridMap(cells.T, resolution_m, float(corner_m[0]), float(corner_m[1]))


def _union(values: NDArray[np.int8]) -> NDArray[np.int8]:
    """(nx, ny) of (nx, ny, nz): unknown < free < occupied, as numbers too."""
    cells = np.full(values.shape[:2], UNKNOWN, dtype=np.int8)
    cells[(values == VOXEL_FREE).any(axis=2)] = FREE
    cells[(values == VOXEL_OCCUPIED).any(axis=2)] = OCCUPIED
    return cells
