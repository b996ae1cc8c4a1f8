"""A 3D map to be localized on: how far the nearest surface is, and where a vehicle can be.

The distances are those of the voxel map, truncated; the planar map beside them is its slice at the
vehicle's height, from whose free cells particles are drawn.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.depth_slice import depth_slice
from mapperd.localization.grid_map import GridMap
from mapperd.mapping.queries import MapQueries

__all__ = ["LocalizationMap", "VolumeMap", "volume_map"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class VolumeMap:
    """Distances in a box, and the free cells of one of its layers.

    Attributes:
        grid: where a vehicle can be, map frame.
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
        """Keep anybody from changing the arrays."""
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
    """Take a box of the 3D map to be localized on.

    Args:
        queries: to the map.
        low_m: (3,) corner of the box, map frame: all that the sonar can see from where the vehicle
            can be; beyond it nothing is known.
        high_m: (3,) corner.
        vehicle_band_m: lowest and highest that the vehicle drives.
        max_distance_m: where distances end, `amcl.laser_likelihood_max_dist`.

    Raises:
        MapError: corners or a band that are none (`bad_slice`).
        ValueError: a distance of over 255 voxels, or too large a box.
    """
    low, high = (np.array(corner, dtype=np.float64) for corner in (low_m, high_m))
    bottom, top = vehicle_band_m
    grid = depth_slice(queries, np.array([*low[:2], bottom]), np.array([*high[:2], top]))
    box = queries.distance_field(low, high, max_distance_m)
    return VolumeMap(grid, box.values, box.first_centre_m, box.resolution_m)
