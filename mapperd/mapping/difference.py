"""Differences of two maps in both directions: occupied voxels that only one has, and distances.

Distances are from centre to centre on the grid of the coarser map: an occupied voxel of the finer
map makes its cell of that grid occupied. Maps of equal resolution are compared voxel by voxel.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import MapError
from mapperd.mapping.queries import MapContent

__all__ = [
    "MAX_REACH_VOXELS",
    "REACH_TOLERANCES",
    "MapChange",
    "MapDifference",
    "OneWayDifference",
    "changes_among",
    "changes_of",
    "compare_maps",
    "compare_parts",
    "occupied_centres",
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
    return compare_parts(
        occupied_centres(first), first, occupied_centres(second), second, tolerance_m
    )


def compare_parts(
    first_m: Floats,
    first: MapContent,
    second_m: Floats,
    second: MapContent,
    tolerance_m: float | None = None,
) -> MapDifference:
    """Compare some occupied voxels of two maps of one frame.

    Args:
        first_m: (N, 3) centres of occupied voxels of the earlier map.
        first: the earlier map.
        second_m: (M, 3) centres of occupied voxels of the later map.
        second: the later map.
        tolerance_m: as of `compare_maps`.

    Raises:
        MapError: as `compare_maps`.
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
    measure = _Measure(grid_m, tolerance_m, reach)
    return MapDifference(
        tolerance_m,
        grid_m,
        reach * grid_m,
        measure.way(first_m, second_m, second),
        measure.way(second_m, first_m, first),
    )


@dataclass(frozen=True, slots=True)
class MapChange:
    """Voxels that touch each other and that one map has and the other has not.

    Attributes:
        kind: whether they `appeared` in the later map or `vanished` from it.
        low_m, high_m: corners of the box around the voxels, map frame.
        voxels: their number.
    """

    kind: Literal["appeared", "vanished"]
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    voxels: int


def changes_of(found: MapDifference, min_voxels: int = 1) -> list[MapChange]:
    """Return what appeared and what vanished, the largest changes first."""
    appeared = found.appeared.centres_m[found.appeared.changed]
    vanished = found.vanished.centres_m[found.vanished.changed]
    link_m = max(found.tolerance_m, found.grid_m)
    return changes_among(appeared, vanished, link_m, found.grid_m, min_voxels)


def changes_among(
    appeared_m: Floats, vanished_m: Floats, link_m: float, edge_m: float, min_voxels: int
) -> list[MapChange]:
    """Return groups of changed voxels, the largest first.

    Args:
        appeared_m: (N, 3) centres of voxels that appeared.
        vanished_m: (M, 3) centres of voxels that vanished.
        link_m: voxels in cubes of this edge that touch belong together.
        edge_m: edge of a voxel.
        min_voxels: smaller groups are left out.
    """
    changes = []
    kinds: tuple[tuple[Literal["appeared", "vanished"], Floats], ...] = (
        ("appeared", appeared_m),
        ("vanished", vanished_m),
    )
    for kind, centres_m in kinds:
        for rows in _groups(centres_m, link_m):
            if len(rows) >= min_voxels:
                low = (centres_m[rows].min(axis=0) - edge_m / 2).tolist()
                high = (centres_m[rows].max(axis=0) + edge_m / 2).tolist()
                changes.append(MapChange(kind, tuple(low), tuple(high), len(rows)))
    return sorted(changes, key=lambda change: -change.voxels)


NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


def _groups(centres_m: Floats, link_m: float) -> Iterator[Ints]:
    """Yield the rows of voxels in cubes that touch."""
    if not len(centres_m):
        return
    cubes, cube_of = np.unique(
        np.floor(centres_m / link_m).astype(np.int64), axis=0, return_inverse=True
    )
    number_of = {tuple(cube): number for number, cube in enumerate(cubes.tolist())}
    group = np.full(len(cubes), -1)
    count = 0
    for first in range(len(cubes)):
        if group[first] >= 0:
            continue
        group[first], waiting = count, [first]
        while waiting:
            x, y, z = cubes[waiting.pop()].tolist()
            for i, j, k in NEIGHBOURS:
                near = number_of.get((x + i, y + j, z + k))
                if near is not None and group[near] < 0:
                    group[near] = count
                    waiting.append(near)
        count += 1
    of_row = group[cube_of.ravel()]
    order = np.argsort(of_row, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(of_row[order])) + 1)


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


def occupied_centres(sonar_map: MapContent) -> Floats:
    """Return the centres (N, 3) of the occupied voxels of a map."""
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
