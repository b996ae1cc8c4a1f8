"""Distances between the maps of two dives, in both directions, where both have observed.

The numbers are those of the analyser of sonar_3d_reconstruction: of the occupied voxels of one map,
how many have an occupied voxel of the other within a tolerance, centre to centre. Voxels that the
other dive has observed are also counted separately: unobserved space is no disagreement.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError
from mapper_survey.tally import Tally
from mapper_survey.windows import Key, WindowedMap
from mapperd.export.cells import indices_of
from mapperd.mapping.difference import (
    MAX_REACH_VOXELS,
    REACH_TOLERANCES,
    squares_to_nearest,
)
from mapperd.mapping.probability import log_odds_of
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import BRICK_VOXELS

__all__ = ["Comparison", "DifferenceCounts", "Disagreement", "cubes_of", "differences"]

CUBE_BRICKS = 2
"""Bricks along an edge of the cube that is compared at once; its surroundings are read too."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class DifferenceCounts:
    """Counts of one dive's occupied voxels against another dive.

    Attributes:
        voxels: number of occupied voxels.
        compared: those that the other dive observed or has an occupied one near.
        common: those with an occupied one of the other within the tolerance.
        called_free: those that are free in the other dive.
        conflicts: those of `called_free` without an occupied one within the tolerance.
        squares: squared distances of the compared, in voxels; beyond the limit its square plus 1.
    """

    voxels: int = 0
    compared: int = 0
    common: int = 0
    called_free: int = 0
    conflicts: int = 0
    squares: Tally = field(default_factory=Tally)


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """Differences within a cube of space.

    Attributes:
        index: (N, 2) columns of the voxels that were compared.
        missing: (N,) bool: nothing of the other dive within the tolerance.
    """

    index: Ints
    missing: NDArray[np.bool_]


class Comparison:
    """Limits of the comparison for maps of one resolution.

    Args:
        resolution_m: edge of a voxel.
        tolerance_m: distance within which voxels are the same.

    Raises:
        SurveyError: the tolerance is not positive or too large.
    """

    def __init__(self, resolution_m: float, tolerance_m: float) -> None:
        max_m = MAX_REACH_VOXELS * resolution_m
        if not 0 < tolerance_m <= max_m:
            raise SurveyError(
                f"tolerance: {tolerance_m:g} m is not allowed; allowed: up to {max_m:g} m"
            )
        self.resolution_m = resolution_m
        self.near = math.floor((tolerance_m / resolution_m) ** 2 + 1e-6)  # squared, in voxels
        far = math.ceil(REACH_TOLERANCES * tolerance_m / resolution_m)
        self.reach = min(far, MAX_REACH_VOXELS)

    def squares(self, other: SonarMap, index: Ints, occupied_log_odds: float) -> Ints:
        """Return squared distances (N,), in voxels, to the nearest occupied voxel of another map.

        Args:
            other: contains everything within `reach` of the voxels.
            index: (N, 3) of voxels, N at least 1.
            occupied_log_odds: voxels of the other above are occupied.
        """
        return squares_to_nearest(other.core, index, self.reach, occupied_log_odds)


def cubes_of(stores: Mapping[str, WindowedMap]) -> list[Key]:
    """Return the positions of all cubes that contain a brick of some map."""
    keys = np.concatenate([stored.keys for stored in stores.values()])
    return [(x, y, z) for x, y, z in np.unique(keys // CUBE_BRICKS, axis=0).tolist()]


def differences(
    stores: Mapping[str, WindowedMap],
    ways: Mapping[tuple[str, str], DifferenceCounts],
    comparison: Comparison,
    progress: Callable[[], None],
) -> Iterator[Disagreement]:
    """Compare every two dives, cube by cube; one dive's cube is in memory at a time.

    Args:
        stores: maps of the dives, by name.
        ways: counts, from the first dive to the second; they are increased.
        comparison: limits of the comparison.
        progress: called after each cube.
    """
    for cube in cubes_of(stores):
        occupied = {name: _occupied(stored, cube) for name, stored in stores.items()}
        for (a, _), way in ways.items():
            way.voxels += len(occupied[a])
        for b, stored in stores.items():
            others = {a: of for a, of in occupied.items() if a != b and len(of)}
            if others:
                yield from _compared(stored, others, {a: ways[a, b] for a in others}, comparison)
        progress()


def _occupied(stored: WindowedMap, cube: Key) -> Ints:
    """Return the indices (N, 3) of a dive's occupied voxels in a cube."""
    low = np.array(cube) * CUBE_BRICKS
    high = low + CUBE_BRICKS - 1
    part = stored.box(low, high)
    if part is None:
        return np.empty((0, 3), dtype=np.int64)
    return indices_of(part.voxels("occupied").centres_m, stored.resolution_m)


def _compared(
    stored: WindowedMap,
    others: Mapping[str, Ints],
    ways: Mapping[str, DifferenceCounts],
    comparison: Comparison,
) -> Iterator[Disagreement]:
    """Compare voxels of other dives in a cube with one dive."""
    together = np.concatenate(list(others.values()))
    low = (together.min(axis=0) - comparison.reach - 1) // BRICK_VOXELS
    high = (together.max(axis=0) + comparison.reach + 1) // BRICK_VOXELS
    part = stored.box(low, high)
    if part is None:
        return
    config = stored.config
    limit = log_odds_of(config.occupied_threshold, "occupied_threshold")
    free = log_odds_of(config.free_threshold, "free_threshold")
    for a, index in others.items():
        squares = comparison.squares(part, index, limit)
        centres_m = np.asarray((index + 0.5) * stored.resolution_m, dtype=np.float64)
        log_odds, count = part.core.query(centres_m)
        common = squares <= comparison.near
        compared = common | (count > 0)
        called_free = (count > 0) & (log_odds < free)
        way = ways[a]
        way.compared += int(compared.sum())
        way.common += int(common.sum())
        way.called_free += int(called_free.sum())
        way.conflicts += int((called_free & ~common).sum())
        way.squares.add(squares[compared])
        yield Disagreement(index[compared, :2], ~common[compared])
