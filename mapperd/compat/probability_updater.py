"""`ProbabilityUpdater`: IWLO updates of points whose evidence the caller has computed.

Names and defaults are those of sonar_3d_reconstruction; the core applies the rule. Deliberate
differences carry the number of the defect that they avoid.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.config.tree import AdaptiveConfig
from mapperd.mapping.probability import flags_of, log_odds_of, numbers_of, points_of
from mapperd.mapping.queries import EVEN, MapQueries, MemoryStats, memory_stats, voxels_above

__all__ = ["ProbabilityUpdater"]


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
