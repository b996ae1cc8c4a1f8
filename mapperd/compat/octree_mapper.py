"""`OctreeMapper`: occupancy by points and rays, with a probability for hit and for miss.

Names and defaults are those of sonar_3d_reconstruction; the map is that of `SonarMap`. Where the
original class had defects this one differs on purpose; the docstrings state where.
"""

from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.errors import MapError
from mapperd.io import atomic_file
from mapperd.mapping.probability import flags_of, log_odds_of, numbers_of, points_of
from mapperd.mapping.queries import EVEN, MapQueries, MemoryStats, memory_stats, voxels_above

__all__ = ["MAX_FILE_BYTES", "OctreeMapper"]

MAX_FILE_BYTES = 2**31
"""A larger file would not become a map that fits into memory."""


class OctreeMapper:
    """A map that hits and misses are added to.

    Points are in metres, map frame; lists or arrays of any real dtype. A refused call leaves the
    map unchanged (batch calls of sonar_3d_reconstruction dropped points that are not finite).

    Args:
        resolution: edge of a voxel, metres.
        prob_hit: probability of an occupied observation, 0.5 or more.
        prob_miss: probability of a free observation, 0.5 or less.
        prob_thres_min: hits and misses do not move a voxel below this probability,
        prob_thres_max: nor above this one.

    Raises:
        ValueError: a resolution or probability out of range.
    """

    def __init__(
        self,
        resolution: float = 0.05,
        prob_hit: float = 0.7,
        prob_miss: float = 0.3,
        prob_thres_min: float = 0.12,
        prob_thres_max: float = 0.97,
    ) -> None:
        self._map = _core.VoxelMap(resolution, _core.IwloParams(L_min=-10.0, L_max=10.0))
        self.set_probability_params(prob_hit, prob_miss)
        self.set_occupancy_thresholds(prob_thres_min, prob_thres_max)

    def update_point(self, point: ArrayLike, occupied: bool) -> None:  # noqa: FBT001 the published name
        """Add one hit or miss.

        Args:
            point: (3,).
            occupied: hit, or miss.

        Raises:
            ValueError: not a finite point in the map's reach.
        """
        self.batch_update(np.atleast_2d(numbers_of(point)), [occupied])

    def batch_update(self, points: ArrayLike, occupied_flags: ArrayLike) -> None:
        """Add hits and misses, in their order; a voxel named twice takes two steps.

        Args:
            points: (N, 3).
            occupied_flags: (N,) booleans: hit, or miss.

        Raises:
            ValueError: wrong shapes, or a point that is not finite or beyond the map's reach.
        """
        steps = np.where(flags_of(occupied_flags), self._hit, self._miss)
        self._map.add_log_odds(points_of(points), steps, low=self._low, high=self._high)

    def batch_update_with_log_odds(self, points: ArrayLike, log_odds_updates: ArrayLike) -> None:
        """Set log-odds: the values are absolute, not steps, and clamped to -10..10.

        Args:
            points: (N, 3).
            log_odds_updates: (N,).

        Raises:
            ValueError: wrong shapes, not finite, or a point beyond the map's reach.
        """
        self._map.set_log_odds(points_of(points), numbers_of(log_odds_updates))

    def insert_ray(self, origin: ArrayLike, endpoint: ArrayLike) -> None:
        """Add a miss to every voxel from the origin on, and a hit to the one of the endpoint.

        Args:
            origin: (3,).
            endpoint: (3,).

        Raises:
            ValueError: not finite, beyond the map's reach, or longer than a million voxels.
        """
        self._map.add_ray(
            numbers_of(origin),
            numbers_of(endpoint),
            hit=self._hit,
            miss=self._miss,
            low=self._low,
            high=self._high,
        )

    def get_occupied_voxels(self, min_probability: float = -1.0) -> NDArray[np.float64]:
        """Voxels above a probability.

        Args:
            min_probability: 0 gives all observed voxels; negative means 0.5.

        Returns:
            (N, 4): x, y, z of the voxel's CENTRE (sonar_3d_reconstruction gave its lowest corner)
            and the probability.

        Raises:
            ValueError: above 1, or not a number.
        """
        return voxels_above(self._map, min_probability)

    @property
    def queries(self) -> MapQueries:
        """Points, boxes, rays and distances: occupied above 0.5, free below."""
        return MapQueries(self._map, occupied_threshold=EVEN, free_threshold=EVEN)

    def merge(self, *others: "OctreeMapper") -> None:
        """Add the evidence of other maps of the same resolution; their order does not matter.

        Log-odds are added, then clamped to -10..10.

        Raises:
            ValueError: another resolution, or the map itself; nothing is changed.
        """
        self._map.merge(*(other._map for other in others))  # noqa: SLF001 of the same class

    def get_memory_usage(self) -> MemoryStats:
        """Voxels, and the memory that is really in use."""
        return memory_stats(self._map)

    def get_num_nodes(self) -> int:
        """Observed voxels and the blocks that hold them; counted by each call."""
        return memory_stats(self._map).num_nodes

    def get_resolution(self) -> float:
        """Edge of a voxel, metres."""
        return self._map.resolution_m

    def set_probability_params(self, prob_hit: float, prob_miss: float) -> None:
        """Set the probabilities of hits and misses.

        Raises:
            ValueError: not 0 < prob_miss <= 0.5 <= prob_hit < 1.
        """
        hit, miss = log_odds_of(prob_hit, "prob_hit"), log_odds_of(prob_miss, "prob_miss")
        if not miss <= 0 <= hit:
            raise ValueError("prob_hit must be at least, prob_miss at most 0.5")
        self._hit, self._miss = hit, miss

    def set_occupancy_thresholds(self, min_thresh: float, max_thresh: float) -> None:
        """Set the probabilities that hits and misses stop at.

        A voxel already beyond is not brought back. Unlike sonar_3d_reconstruction's, max_thresh is
        not also the threshold of being occupied, which called everything not saturated free.

        Raises:
            ValueError: not 0 < min_thresh < 0.5 < max_thresh < 1.
        """
        low, high = log_odds_of(min_thresh, "min_thresh"), log_odds_of(max_thresh, "max_thresh")
        if not low < 0 < high:
            raise ValueError("min_thresh must be below, max_thresh above 0.5")
        self._low, self._high = low, high

    def prune_tree(self) -> int:
        """Merge equal voxels; returns the nodes removed, which is 0.

        The map always keeps space of one state as one, so nothing is ever left to prune.
        """
        return 0

    def clear(self) -> None:
        """Forget everything."""
        self._map.clear()

    def save_to_file(self, filename: str | PathLike[str]) -> bool:
        """Write an OctoMap tree, whole or not at all.

        `.bt` holds classes alone: occupied above 0.5, free below. `.ot` holds log-odds.
        Neither holds counts. No output of the process is redirected.

        Returns:
            True; failing is an exception.

        Raises:
            ValueError: another suffix.
            ExportError: the file cannot be written.
            MapError: a voxel lies beyond OctoMap's keys, 32768 voxels from the origin.
        """
        path = Path(filename)
        if path.suffix not in (".bt", ".ot"):
            raise ValueError(f"{path}: a name that ends in .bt or .ot was expected")
        try:
            binary = path.suffix == ".bt"
            data = self._map.octomap_bt(0.0, 0.0) if binary else self._map.octomap_ot()
        except IndexError as error:
            raise MapError(str(error), "out_of_reach") from error
        with atomic_file(path) as file:
            file.write(data)
        return True

    def load_from_file(self, filename: str | PathLike[str]) -> bool:
        """Replace the content by that of an OctoMap tree, `.bt` or `.ot`.

        What was loaded answers all queries (sonar_3d_reconstruction filled a tree that its queries
        did not read). Counts become 1; a `.bt`, having classes alone, gives log-odds -2 and 3.5.

        Returns:
            True; failing is an exception, and leaves the map as it was.

        Raises:
            MapError: the file cannot be read, is no tree, or has another resolution.
        """
        path = Path(filename)
        try:
            if path.stat().st_size > MAX_FILE_BYTES:
                raise MapError(f"{path}: larger than {MAX_FILE_BYTES} bytes", "bad_octomap_file")
            data = path.read_bytes()
        except OSError as error:
            raise MapError(f"{path}: cannot be read: {error.strerror}", "unreadable") from error
        try:
            self._map.load_octomap(data)
        except ValueError as error:
            raise MapError(f"{path}: {error}", "bad_octomap_file") from error
        return True
