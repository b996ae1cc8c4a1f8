"""`OctreeMapper` and `ProbabilityUpdater`: occupancy by points and rays, and by weighted points.

Names and defaults are those of sonar_3d_reconstruction; the core applies the rule. Where the
original classes had defects these differ on purpose; the docstrings state where.
"""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.config.tree import AdaptiveConfig
from mapperd.errors import MapError
from mapperd.io import atomic_file
from mapperd.mapping.probability import flags_of, log_odds_of, numbers_of, points_of
from mapperd.mapping.queries import EVEN, MapQueries, MemoryStats, memory_stats, voxels_above

__all__ = [
    "MAX_FILE_BYTES",
    "OctreeMapper",
    "ProbabilityUpdater",
]

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


class ProbabilityUpdater:
    """A map that weighted observations of points are added to.

    A setter changes what is learnt from then on. New clamps and learning rates hold for the whole
    map at once: what lies outside the clamps is brought inside.

    Args:
        resolution: edge of a voxel, metres.

    Raises:
        ValueError: the resolution is no length.
    """

    def __init__(self, resolution: float = 0.05) -> None:
        # sonar_3d_reconstruction's own defaults of this class, not those of the settings.
        self._rule: dict[str, Any] = {"sharpness": 0.1, "min_alpha": 0.3}
        self._adaptive = True
        self._occupied_threshold = 0.7
        self._map = _core.VoxelMap(resolution, self._params())

    def _params(self, **changes: float) -> _core.IwloParams:
        return _core.IwloParams(adaptive_update=self._adaptive, **{**self._rule, **changes})

    def _change(self, **changes: float) -> None:
        """Bring the map under a changed rule; a rule that is refused changes nothing."""
        self._map = self._map.with_rule(self._params(**changes))
        self._rule |= changes

    def set_log_odds_params(self, log_odds_occupied: float, log_odds_free: float) -> None:
        """Set the largest steps: L_occ (0 or more) and L_free (0 or less).

        Raises:
            ValueError: out of range.
        """
        self._change(L_occ=log_odds_occupied, L_free=log_odds_free)

    def set_adaptive_params(
        self,
        enable: bool,  # noqa: FBT001 the published name
        threshold: float,
        max_ratio: float,
        min_ratio: float | None = None,
    ) -> None:
        """Set the protection of what is believed: on or off, probability (0..1], factor [0..1].

        Below `threshold` an occupied observation moves a voxel by at least `min_ratio` of the
        largest step, L_occ w; 0 is the original rule, by which a voxel that was seen free five
        times stays so. None means 0.25, or `max_ratio` where that is less.

        Raises:
            ValueError: out of range.
        """
        before, self._adaptive = self._adaptive, bool(enable)
        try:
            self._change(
                adaptive_threshold=threshold,
                adaptive_max_ratio=max_ratio,
                adaptive_min_ratio=min(AdaptiveConfig().min_ratio, max_ratio)
                if min_ratio is None
                else min_ratio,
            )
        except ValueError:
            self._adaptive = before
            raise

    def set_clamping_thresholds(self, min_prob: float, max_prob: float) -> None:
        """Set the clamps as probabilities; the same clamps as L_min and L_max.

        sonar_3d_reconstruction clamped twice, here and to a fixed -10..10, and made max_prob the
        threshold of being occupied. Here is one pair of clamps, and what is set last holds.

        Raises:
            ValueError: not 0 < min_prob < 0.5 < max_prob < 1.
        """
        low, high = log_odds_of(min_prob, "min_prob"), log_odds_of(max_prob, "max_prob")
        self._change(L_min=low, L_max=high)

    def set_iwlo_params(
        self,
        sharpness: float,
        decay_rate: float,
        min_alpha: float,
        L_min: float,  # noqa: N803 the published name
        L_max: float,  # noqa: N803
    ) -> None:
        """Set the rule's shape and clamps.

        Raises:
            ValueError: out of range.
        """
        self._change(
            sharpness=sharpness,
            decay_rate=decay_rate,
            min_alpha=min_alpha,
            L_min=L_min,
            L_max=L_max,
        )

    def set_intensity_params(self, intensity_threshold: float, intensity_max: float) -> None:
        """Set the intensities of the smallest and the largest weight.

        Raises:
            ValueError: not finite.
        """
        self._change(intensity_threshold=intensity_threshold, intensity_max=intensity_max)

    def set_occupied_threshold(self, threshold: float) -> None:
        """Set the probability above which `queries` call a voxel occupied.

        Raises:
            ValueError: not between 0 and 1.
        """
        log_odds_of(threshold, "threshold")
        self._occupied_threshold = threshold

    def batch_update_iwlo(
        self,
        points: ArrayLike,
        intensities: ArrayLike,
        occupied: ArrayLike,
        weights: ArrayLike | None = None,
    ) -> None:
        """Add one observation a point, in their order; a voxel named twice is observed twice.

        The flag decides between occupied and free (sonar_3d_reconstruction ignored it and tested
        the intensity again). An occupied point that is not above the intensity threshold has weight
        0: it counts as an observation and changes nothing. A weight multiplies its point's step and
        does not enter the count; pass sample counts as weights only if the samples are independent.

        Args:
            points: (N, 3), metres, map frame.
            intensities: (N,), 0 or more; those of free points are not used.
            occupied: (N,) booleans.
            weights: (N,), 0 or more; None or empty means 1.

        Raises:
            ValueError: wrong shapes, or a number that is not finite or out of range; the map is
                as it was.
        """
        factors = None if weights is None else numbers_of(weights)
        if factors is not None and factors.size == 0:
            factors = None
        self._map.observe(points_of(points), numbers_of(intensities), flags_of(occupied), factors)

    def get_occupied_voxels(self, min_probability: float = EVEN) -> NDArray[np.float64]:
        """Voxels above a probability; 0 gives all observed ones, negative means 0.5.

        Returns:
            (N, 4): x, y, z of the voxel's CENTRE (sonar_3d_reconstruction gave its lowest corner)
            and the probability.

        Raises:
            ValueError: above 1, or not a number.
        """
        return voxels_above(self._map, min_probability)

    def get_observation_count(self, key: Sequence[int]) -> int:
        """Observations of the voxel with index (ix, iy, iz); 0 if it was never observed.

        It saturates, without loss, where the learning rate no longer changes. In
        sonar_3d_reconstruction the key was the text "ix_iy_iz".

        Raises:
            ValueError: not three whole numbers.
        """
        index = np.asarray(key)
        if index.shape != (3,) or index.dtype.kind not in "iu":
            raise ValueError("a key is three whole numbers (ix, iy, iz)")
        centre = (index + 0.5) * self._map.resolution_m
        _, counts = self._map.query(centre.reshape(1, 3))
        return int(counts[0])

    @property
    def queries(self) -> MapQueries:
        """Points, boxes, rays and distances.

        Occupied above the occupied threshold, free below 0.5 or that, whichever is lower.
        """
        limit = self._occupied_threshold
        return MapQueries(self._map, occupied_threshold=limit, free_threshold=min(limit, EVEN))

    def get_memory_usage(self) -> MemoryStats:
        """Voxels, and the memory that is really in use."""
        return memory_stats(self._map)

    def get_num_nodes(self) -> int:
        """Observed voxels and the blocks that hold them; counted by each call."""
        return memory_stats(self._map).num_nodes

    def get_resolution(self) -> float:
        """Edge of a voxel, metres."""
        return self._map.resolution_m

    def prune_tree(self) -> int:
        """Merge equal voxels; returns the nodes removed, which is 0: none are ever kept."""
        return 0

    def clear(self) -> None:
        """Forget all voxels; the parameters stay."""
        self._map.clear()

    def set_incremental_sync(self, enable: bool) -> None:  # noqa: FBT001 the published name
        """Accept either value: there is one map, and no second store to bring up to date."""

    def force_full_sync(self) -> None:
        """Return at once: every query reads the one map, which is always up to date."""
