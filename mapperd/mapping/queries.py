"""Queries of a map: voxels, rays, distances, memory.

Positions are in metres in the map frame, and those of voxels are their centres. A box holds the
voxels whose centres lie in low <= centre < high, so that adjacent boxes share none. Queries keep no
copies.

`MapContent` is the readable content of a map: in memory or in its file, whole or in parts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.mapping.probability import log_odds_of, numbers_of, points_of, probabilities_of
from mapperd.mapping.sonar_map import MapCounts, Voxels

__all__ = [
    "EVEN",
    "FREE",
    "OCCUPIED",
    "UNKNOWN",
    "BoxGrid",
    "MapContent",
    "MapQueries",
    "MemoryStats",
    "VoxelCloud",
    "memory_stats",
    "voxels_above",
]


class VoxelCloud(Protocol):
    """Voxels in the map's fixed order; only a part is in memory at a time."""

    def __len__(self) -> int:
        """Return their number."""

    @property
    def box_m(self) -> NDArray[np.float64]:
        """(2, 3) float64, lowest and highest centre, map frame; zeros without voxels."""

    def batches(self) -> Iterator[Voxels]:
        """Yield all voxels; every call starts again."""


class MapContent(Protocol):
    """Content of a map for exports: `SonarMap` in memory, `StoredMap` in its file."""

    config: Config

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""

    @property
    def memory_bytes(self) -> int:
        """Memory of the map while it is read."""

    @property
    def bricks_lost(self) -> int:
        """Damaged bricks, whose space is unknown."""

    def occupied(self) -> VoxelCloud:
        """Return the occupied voxels."""

    def counts(self) -> MapCounts:
        """Count the observed voxels by class."""

    def sha256(self) -> str:
        """Return the fingerprint of the content; see `SonarMap.sha256`."""

    def parts(self) -> Iterator[_core.VoxelMap]:
        """Yield disjoint parts of the map in its fixed order.

        Each is valid until the next.
        """

    def save(self, path: Path) -> None:
        """Write the map without loss; see `SonarMap.save`."""

    def save_octomap(self, path: Path) -> None:
        """Write OctoMap's tree: `.bt` with classes, `.ot` with log-odds."""

    def close(self) -> None:
        """Close the source."""


UNKNOWN: Final = -1
"""Never observed, or observed without a clear result (between the two thresholds)."""

FREE: Final = 0
OCCUPIED: Final = 1

EVEN: Final = 0.5
"""Probability of an unknown voxel."""

Number = TypeVar("Number", np.int8, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class BoxGrid(Generic[Number]):
    """One number for each voxel of a box.

    Attributes:
        values: (nx, ny, nz), indexed [x, y, z].
        first_centre_m: (3,) float64, centre of the voxel [0, 0, 0].
        resolution_m: edge of a voxel; the centre of [i, j, k] is first_centre_m + resolution_m *
            (i, j, k).
    """

    values: NDArray[Number]
    first_centre_m: NDArray[np.float64]
    resolution_m: float


class MapQueries:
    """Queries of a map; answers reflect its current content.

    Args:
        core: the map.
        occupied_threshold: voxels above this probability are occupied.
        free_threshold: observed voxels below this probability are free; at most
            occupied_threshold.

    Raises:
        ValueError: the thresholds are not probabilities or out of order.
    """

    def __init__(
        self, core: _core.VoxelMap, *, occupied_threshold: float, free_threshold: float
    ) -> None:
        self._core = core
        self._occupied = log_odds_of(occupied_threshold, "occupied_threshold")
        self._free = log_odds_of(free_threshold, "free_threshold")
        if free_threshold > occupied_threshold:
            raise ValueError("free_threshold must be at most occupied_threshold")

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""
        return self._core.resolution_m

    def classify(self, points: ArrayLike) -> NDArray[np.int8]:
        """Return OCCUPIED, FREE or UNKNOWN at points; UNKNOWN outside the map's range.

        Args:
            points: (N, 3).

        Returns:
            (N,) int8.

        Raises:
            ValueError: wrong shape, or not finite.
        """
        return self._core.classify(points_of(points), self._occupied, self._free)

    def classify_box(self, low: ArrayLike, high: ArrayLike) -> BoxGrid[np.int8]:
        """Return OCCUPIED, FREE or UNKNOWN for every voxel of a box.

        Args:
            low: (3,) corner.
            high: (3,) corner, not below it.

        Raises:
            ValueError: corners that are not finite or not in order, or over 2**27 voxels.
        """
        corners = numbers_of(low), numbers_of(high)
        grid, first = self._core.classify_box(*corners, self._occupied, self._free)
        return BoxGrid(grid, first, self._core.resolution_m)

    def ray_cast_depth(
        self, origins: ArrayLike, directions: ArrayLike, max_range: float
    ) -> NDArray[np.float64]:
        """Return the distance from each origin to where its ray enters an occupied voxel.

        Every voxel on the ray is tested (the fixed steps of sonar_3d_reconstruction miss corners).
        Unknown space does not stop a ray.

        Args:
            origins: (N, 3).
            directions: (N, 3), of any length except 0.
            max_range: metres, at most a million voxels.

        Returns:
            (N,) float64, metres: 0 if the ray starts in an occupied voxel, -1 if it meets none
            within max_range.

        Raises:
            ValueError: wrong shapes, numbers that are not finite, a direction of length 0.
        """
        return self._core.ray_cast_depth(
            points_of(origins), points_of(directions), max_range, self._occupied
        )

    def distance_field(
        self, low: ArrayLike, high: ArrayLike, max_distance: float
    ) -> BoxGrid[np.float32]:
        """Return the exact Euclidean distance from voxel centres to the nearest occupied centre.

        Occupied voxels outside the box count too. Distances are truncated at max_distance.

        Args:
            low: (3,) corner.
            high: (3,) corner, not below it.
            max_distance: metres, at most 255 voxels.

        Raises:
            ValueError: bad corners, a bad distance, or over 2**27 voxels in the box with
                max_distance around it.
        """
        corners = numbers_of(low), numbers_of(high)
        field, first = self._core.distance_field(*corners, max_distance, self._occupied)
        return BoxGrid(field, first, self._core.resolution_m)

    def distance_slice(
        self, low: ArrayLike, high: ArrayLike, z: float, max_distance: float
    ) -> BoxGrid[np.float32]:
        """Return the layer of `distance_field` at height z, shape (nx, ny, 1).

        Args:
            low: (2,) corner, x and y.
            high: (2,) corner, not below it.
            z: height in metres.
            max_distance: metres, at most 255 voxels.

        Raises:
            ValueError: as `distance_field`.
        """
        corners = numbers_of(low), numbers_of(high)
        field, first = self._core.distance_slice(*corners, z, max_distance, self._occupied)
        return BoxGrid(field, first, self._core.resolution_m)

    def occupied_in(self, low: ArrayLike, high: ArrayLike) -> Voxels:
        """Return the occupied voxels of a box of any size, in the map's fixed order.

        Args:
            low: (3,) corner.
            high: (3,) corner, not below it.

        Raises:
            ValueError: corners that are not finite or not in order.
        """
        corners = numbers_of(low), numbers_of(high)
        centres, log_odds, count = self._core.occupied_in(*corners, self._occupied)
        return Voxels(centres, probabilities_of(log_odds).astype(np.float32), count)


def voxels_above(core: _core.VoxelMap, min_probability: float) -> NDArray[np.float64]:
    """Return the voxels above a probability; 0 means all observed ones, negative means 0.5.

    Returns:
        (N, 4): x, y, z of the centre, probability.

    Raises:
        ValueError: above 1, or not a number.
    """
    if not min_probability <= 1:
        raise ValueError(f"min_probability must be at most 1, not {min_probability!r}")
    limits = {0.0: -np.inf, 1.0: np.inf}
    asked = EVEN if min_probability < 0 else float(min_probability)
    limit = limits[asked] if asked in limits else log_odds_of(asked, "min_probability")
    centres, log_odds, _ = core.voxels(min_log_odds=limit)
    return np.column_stack([centres, probabilities_of(log_odds)])


@dataclass(frozen=True, slots=True)
class MemoryStats:
    """Memory, in the fields of sonar_3d_reconstruction, which reported 1/12 to 1/18 of it.

    Attributes:
        num_nodes: observed voxels and the blocks that hold them.
        num_leaf_nodes: observed voxels.
        memory_mb: memory in use, in MiB of 2**20 bytes.
        memory_efficiency: num_leaf_nodes / num_nodes, 0 for an empty map.
    """

    num_nodes: int
    num_leaf_nodes: int
    memory_mb: float
    memory_efficiency: float


def memory_stats(core: _core.VoxelMap) -> MemoryStats:
    """Count a map's voxels and its memory."""
    leaves = core.known_count()
    nodes = leaves + core.block_count
    return MemoryStats(
        num_nodes=nodes,
        num_leaf_nodes=leaves,
        memory_mb=core.memory_bytes / 2**20,
        memory_efficiency=leaves / nodes if nodes else 0.0,
    )
