"""Differences of two maps in both directions: occupied voxels that only one has, and distances.

Distances are from centre to centre on the grid of the coarser map: an occupied voxel of the finer
map makes its cell of that grid occupied. Maps of equal resolution are compared voxel by voxel.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import MapError
from mapperd.mapping.queries import MapContent

__all__ = [
    "MAX_REACH_VOXELS",
    "REACH_TOLERANCES",
    "MapDifference",
    "OneWayDifference",
    "compare_maps",
    "squares_to_nearest",
]

MAX_REACH_VOXELS = 60
"""Maximum distance that is measured: below a brick and the limit of the core's distance field."""

REACH_TOLERANCES = 5
"""Distances are measured up to this number of tolerances; greater ones are `farther`."""

CUBE_VOXELS = 64
"""Edge of the cube whose distances are computed at once."""

SURE = 3.0
"""Log-odds of the cells of the common grid."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class OneWayDifference:
    """From the occupied voxels of one map to those of the other.

    Attributes:
        centres_m: (N, 3) of the voxels, map frame.
        distance_m: (N,) to the nearest of the other map; infinite beyond the limit.
        same: (N,) the other map has one within the tolerance.
        seen: (N,) the other map observed the place or has one within the tolerance.
    """

    centres_m: Floats
    distance_m: Floats
    same: Bools
    seen: Bools

    @property
    def changed(self) -> Bools:
        """(N,) the other map has observed the place and has nothing within the tolerance."""
        return self.seen & ~self.same

    def quantile_m(self, share: float) -> float | None:
        """Return a quantile of the distances in observed space; None beyond the limit."""
        distance_m = np.sort(self.distance_m[self.seen])
        if not len(distance_m):
            return None
        value = float(distance_m[min(math.ceil(share * len(distance_m)), len(distance_m)) - 1])
        return value if math.isfinite(value) else None


@dataclass(frozen=True, slots=True, eq=False)
class MapDifference:
    """Differences of two maps in both directions.

    Attributes:
        tolerance_m: distance within which voxels are the same.
        grid_m: edge of a cell of the common grid.
        reach_m: distances beyond are not measured.
        vanished: from the voxels of the first map; `changed` ones are missing in the second.
        appeared: from the voxels of the second map; `changed` ones are missing in the first.
    """

    tolerance_m: float
    grid_m: float
    reach_m: float
    vanished: OneWayDifference
    appeared: OneWayDifference


def compare_maps(
    first: MapContent, second: MapContent, tolerance_m: float | None = None
) -> MapDifference:
    """Compare two maps of one frame; memory holds the occupied voxels of both.

    Args:
        first: the earlier map.
        second: the later map.
        tolerance_m: distance within which voxels are the same; None is two cells of the grid.

    Raises:
        MapError: the tolerance is not positive or too large (`bad_tolerance`).
    """
    grid_m = max(first.resolution_m, second.resolution_m)
    tolerance_m = 2 * grid_m if tolerance_m is None else tolerance_m
    max_m = MAX_REACH_VOXELS * grid_m
    if not 0 < tolerance_m <= max_m:
        raise MapError(
            f"tolerance of {tolerance_m:g} m: more than 0 and at most {max_m:g} m are allowed "
            f"with voxels of {grid_m:g} m",
            "bad_tolerance",
        )
    reach = min(math.ceil(REACH_TOLERANCES * tolerance_m / grid_m), MAX_REACH_VOXELS)
    one, other = _centres_of(first), _centres_of(second)
    measure = _Measure(grid_m, tolerance_m, reach)
    return MapDifference(
        tolerance_m,
        grid_m,
        reach * grid_m,
        measure.way(one, other, second),
        measure.way(other, one, first),
    )


@dataclass(frozen=True, slots=True)
class _Measure:
    grid_m: float
    tolerance_m: float
    reach: int

    def way(self, centres_m: Floats, other_m: Floats, other: MapContent) -> OneWayDifference:
        """Measure from voxels to those of another map."""
        cells = _core.VoxelMap(self.grid_m, _core.IwloParams(L_min=-2 * SURE, L_max=2 * SURE))
        if len(other_m):
            index = np.floor(other_m / self.grid_m)
            cells.set_log_odds((index + 0.5) * self.grid_m, np.full(len(index), SURE))
        squares = np.empty(len(centres_m), dtype=np.int64)
        indices = np.floor(centres_m / self.grid_m).astype(np.int64)
        for rows in _cubes(indices):
            squares[rows] = squares_to_nearest(cells, indices[rows], self.reach, 0.0)
        near = math.floor((self.tolerance_m / self.grid_m) ** 2 + 1e-6)
        same = squares <= near
        seen = same.copy()
        seen[~same] = _observed(other, centres_m[~same])
        distance_m = np.where(
            squares > self.reach**2, np.inf, np.sqrt(squares.astype(np.float64)) * self.grid_m
        )
        return OneWayDifference(centres_m, distance_m, same, seen)


def squares_to_nearest(
    core: _core.VoxelMap, index: Ints, reach: int, occupied_log_odds: float
) -> Ints:
    """Return squared distances (N,), in voxels, to the nearest occupied voxel of a map.

    Args:
        core: the map.
        index: (N, 3) of voxels that lie near each other, N at least 1.
        reach: limit in voxels; greater distances give its square plus 1.
        occupied_log_odds: voxels above are occupied.
    """
    low, high = index.min(axis=0), index.max(axis=0) + 1
    edge_m = core.resolution_m
    field_m, _ = core.distance_field(
        low * edge_m, high * edge_m, (reach + 1) * edge_m, occupied_log_odds
    )
    to_nearest = field_m[tuple((index - low).T)].astype(np.float64) / edge_m
    squares: Ints = np.rint(to_nearest**2).astype(np.int64)
    return np.minimum(squares, reach**2 + 1)


def _centres_of(sonar_map: MapContent) -> Floats:
    batches = [voxels.centres_m for voxels in sonar_map.occupied().batches()]
    return np.concatenate(batches) if batches else np.empty((0, 3))


def _cubes(indices: Ints) -> Iterator[Ints]:
    """Yield rows of voxels that lie in one cube."""
    if not len(indices):
        return
    _, cube = np.unique(indices // CUBE_VOXELS, axis=0, return_inverse=True)
    order = np.argsort(cube.ravel(), kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(cube.ravel()[order])) + 1)


def _observed(sonar_map: MapContent, points_m: Floats) -> Bools:
    """Return (N,) whether a map has observed points."""
    seen = np.zeros(len(points_m), dtype=np.bool_)
    if len(points_m):
        for part in sonar_map.parts():
            seen |= part.query(points_m)[1] > 0
    return seen
