"""Maps for localization: planar grids, and distances, slices and surfaces of a 3D map.

Distances are those of the voxel map, truncated. With them comes a planar map: the slice at the
vehicle's height, from whose free cells particles are drawn.

Slices: a ping measures no elevation, so a beam detects the nearest structure anywhere in its
vertical aperture. A cell of the slice is therefore occupied if any voxel of the covered band is.

Surfaces: an echo is longer than a wall is thick, so a sonar's map has walls as deep as its echoes.
A scan has only the front. If the whole depth counted as surface, the estimate would be too near by
half of it.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import MapError
from mapperd.mapping.probability import log_odds_of
from mapperd.mapping.queries import FREE as VOXEL_FREE
from mapperd.mapping.queries import OCCUPIED as VOXEL_OCCUPIED
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import SonarMap

__all__ = [
    "FREE",
    "MAX_CELLS",
    "OCCUPIED",
    "UNKNOWN",
    "GridMap",
    "LocalizationMap",
    "VolumeMap",
    "beam_band_m",
    "depth_slice",
    "keep_boundaries",
    "volume_map",
]

Floats = NDArray[np.float64]

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

MAX_CELLS = 1 << 27
"""Maximum cells of a map: 134 million, 1.1 km x 1.1 km of 0.1 m cells."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """A planar map: cells in rows along x, row upon row along y.

    Its frame may be turned in the map.

    Attributes:
        occupancy: (rows, columns) int8, read-only: -1 unknown, 0 free, 100 occupied, percent in
            between.
        resolution_m: edge of a cell.
        origin_x_m, origin_y_m, origin_yaw_rad: the outer corner of cell [0, 0] in the map frame.

    Raises:
        ValueError: no or too many cells, invalid values, or numbers that are not finite.
    """

    occupancy: NDArray[np.int8]
    resolution_m: float
    origin_x_m: float = 0.0
    origin_y_m: float = 0.0
    origin_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        """Copy the cells and make them read-only."""
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
        """Return the centres (N, 2) of cells in the map frame."""
        c, s = math.cos(self.origin_yaw_rad), math.sin(self.origin_yaw_rad)
        x = (np.asarray(column) + 0.5) * self.resolution_m
        y = (np.asarray(row) + 0.5) * self.resolution_m
        return np.stack([self.origin_x_m + c * x - s * y, self.origin_y_m + s * x + c * y], axis=-1)

    def cells_at(self, points_m: Floats) -> NDArray[np.int8]:
        """Return the values (N,) at points (N, 2), map frame; unknown outside and at NaN."""
        c, s = math.cos(self.origin_yaw_rad), math.sin(self.origin_yaw_rad)
        x, y = points_m[:, 0] - self.origin_x_m, points_m[:, 1] - self.origin_y_m
        column = np.floor((c * x + s * y) / self.resolution_m)
        row = np.floor((-s * x + c * y) / self.resolution_m)
        rows, columns = self.occupancy.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        values = np.full(len(points_m), UNKNOWN, dtype=np.int8)
        values[inside] = self.occupancy[row[inside].astype(int), column[inside].astype(int)]
        return values


VOXELS_AT_ONCE = 1 << 24


def beam_band_m(
    sonar_z_m: float, range_m: float, vertical_aperture_rad: float, tilt_down_rad: float = 0.0
) -> tuple[float, float]:
    """Return the minimum and maximum height that a beam covers up to a range, map frame.

    Args:
        sonar_z_m: height of the sonar in the map.
        range_m: slant range.
        vertical_aperture_rad: full aperture.
        tilt_down_rad: tilt of the fan's plane, mounting and pitch together.
    """
    half = vertical_aperture_rad / 2
    sines = [math.sin(-tilt_down_rad + e) for e in (-half, half)]
    heights = [0.0, *(range_m * sine for sine in sines)]
    return sonar_z_m + min(heights), sonar_z_m + max(heights)


def depth_slice(queries: MapQueries, low_m: Floats, high_m: Floats) -> GridMap:
    """Project a box of the map to a planar map.

    A cell is occupied if one of its voxels is; otherwise free if one is free; otherwise unknown.

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
    """Return the maximum over z, (nx, ny): unknown < free < occupied."""
    cells = np.full(values.shape[:2], UNKNOWN, dtype=np.int8)
    cells[(values == VOXEL_FREE).any(axis=2)] = FREE
    cells[(values == VOXEL_OCCUPIED).any(axis=2)] = OCCUPIED
    return cells


@dataclass(frozen=True, slots=True, eq=False)
class VolumeMap:
    """Distances in a box, and the free cells of one of its layers.

    Attributes:
        grid: free space of the vehicle, map frame.
        distances_m: (nx, ny, nz) float32, read-only, from voxel centres to the nearest occupied
            voxel's centre, truncated.
        first_centre_m: (3,) of voxel [0, 0, 0], map frame.
        resolution_m: edge of a voxel.
    """

    grid: GridMap
    distances_m: NDArray[np.float32]
    first_centre_m: Floats
    resolution_m: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        self.distances_m.setflags(write=False)
        self.first_centre_m.setflags(write=False)

    @property
    def has_free_cells(self) -> bool:
        """Whether a vehicle can be anywhere on it."""
        return self.grid.has_free_cells


LocalizationMap = GridMap | VolumeMap


def volume_map(
    queries: MapQueries,
    low_m: Floats,
    high_m: Floats,
    vehicle_band_m: tuple[float, float],
    max_distance_m: float,
) -> VolumeMap:
    """Extract a box of the 3D map for localization.

    Args:
        queries: to the map.
        low_m: (3,) corner of the box, map frame: it must contain all that the sonar can see;
            everything outside is unknown.
        high_m: (3,) corner.
        vehicle_band_m: minimum and maximum height of the vehicle.
        max_distance_m: limit of distances, `amcl.laser_likelihood_max_dist`.

    Raises:
        MapError: invalid corners or band (`bad_slice`).
        ValueError: a distance of over 255 voxels, or too large a box.
    """
    low, high = (np.array(corner, dtype=np.float64) for corner in (low_m, high_m))
    bottom, top = vehicle_band_m
    grid = depth_slice(queries, np.array([*low[:2], bottom]), np.array([*high[:2], top]))
    box = queries.distance_field(low, high, max_distance_m)
    return VolumeMap(grid, box.values, box.first_centre_m, box.resolution_m)


SIDES = np.concatenate([np.eye(3), -np.eye(3)])


def keep_boundaries(sonar_map: SonarMap) -> int:
    """Set occupied voxels without a free face neighbour to uncertain.

    Returns:
        Number of voxels that stay occupied.
    """
    config = sonar_map.config
    queries = MapQueries(
        sonar_map.core,
        occupied_threshold=config.occupied_threshold,
        free_threshold=config.free_threshold,
    )
    occupied_m = sonar_map.voxels("occupied").centres_m
    beside = np.zeros(len(occupied_m), dtype=np.bool_)
    for side in SIDES:
        beside |= queries.classify(occupied_m + sonar_map.resolution_m * side) == VOXEL_FREE
    behind_m = occupied_m[~beside]
    limits = config.free_threshold, config.occupied_threshold
    between = float(np.mean([log_odds_of(limit, "threshold") for limit in limits]))
    sonar_map.core.set_log_odds(behind_m, np.full(len(behind_m), between))
    return int(beside.sum())
