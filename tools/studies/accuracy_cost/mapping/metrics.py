"""What a map is worth beside the truth: distances, F-scores, ROC area, calibration.

All of it is float64 NumPy on plain arrays, so that it can be checked by hand.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from studies.accuracy_cost.mapping.solids import World

__all__ = [
    "BINS",
    "Reliability",
    "Surfaces",
    "reliability",
    "roc_area",
    "sampled",
    "surfaces",
]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

BINS = 10
NEAR_VOXELS = 1.5
"""A voxel that holds a surface has its centre up to 0.87 edges from it, a neighbour 1.5."""
NEAR_M = 0.15
FALSE_M = 0.25
CAP_M = 0.5
"""Wrong is wrong: how far beyond this does not count any more."""
LEAST_IN_BIN = 100
"""Voxels; a bin with fewer says nothing of its share."""
SAMPLED_EDGE_M = 0.1
"""Of finer voxels about as many are looked at as there are of these."""


@dataclass(frozen=True, slots=True)
class Surfaces:
    """Distances between occupied voxels and the true surface.

    Attributes:
        accuracy_median_m, accuracy_p95_m: of occupied voxels' centres to the surface.
        completeness_median_m, completeness_p95_m: of the surface in sight to such a centre.
        complete_voxels, complete_fixed: share of it nearer than 1.5 edges, and than 0.15 m.
        f_one, f_two: harmonic mean of both shares within one and within two edges.
        false_share: of the occupied voxels, farther than 0.25 m from any surface.
        error_m: mean over both ways of the mean distance, each counted as 0.5 m at most.
    """

    accuracy_median_m: float
    accuracy_p95_m: float
    completeness_median_m: float
    completeness_p95_m: float
    complete_voxels: float
    complete_fixed: float
    f_one: float
    f_two: float
    false_share: float
    error_m: float


def surfaces(world: World, seen_m: Floats, occupied_m: Floats, edge_m: float) -> Surfaces:
    """Compare a map's surface with the truth.

    Args:
        world: the truth.
        seen_m: points (M, 3) of its surface that the sonar had in sight.
        occupied_m: centres (N, 3) of the occupied voxels.
        edge_m: of a voxel.
    """
    if len(occupied_m) == 0:
        nan = float("nan")
        return Surfaces(nan, nan, nan, nan, 0.0, 0.0, 0.0, 0.0, nan, CAP_M)
    off_m = np.abs(world.distance_m(occupied_m))
    gap_m, _ = cKDTree(occupied_m).query(seen_m)
    accuracy_m, completeness_m = (np.quantile(way, (0.5, 0.95)) for way in (off_m, gap_m))
    means = [float(np.minimum(way, CAP_M).mean()) for way in (off_m, gap_m)]
    return Surfaces(
        accuracy_median_m=float(accuracy_m[0]),
        accuracy_p95_m=float(accuracy_m[1]),
        completeness_median_m=float(completeness_m[0]),
        completeness_p95_m=float(completeness_m[1]),
        complete_voxels=float(np.mean(gap_m <= NEAR_VOXELS * edge_m)),
        complete_fixed=float(np.mean(gap_m <= NEAR_M)),
        f_one=_harmonic(off_m, gap_m, edge_m),
        f_two=_harmonic(off_m, gap_m, 2 * edge_m),
        false_share=float(np.mean(off_m > FALSE_M)),
        error_m=sum(means) / 2.0,
    )


def _harmonic(off_m: Floats, gap_m: Floats, within_m: float) -> float:
    right, found = float(np.mean(off_m <= within_m)), float(np.mean(gap_m <= within_m))
    return 0.0 if right + found == 0.0 else 2.0 * right * found / (right + found)


def sampled(centres_m: Floats, edge_m: float) -> NDArray[np.int64]:
    """Which voxels (N,) to look at: of fine ones an even part, the same of every map."""
    every = max(1, round((SAMPLED_EDGE_M / edge_m) ** 3))
    if every == 1:
        return np.arange(len(centres_m))
    place = np.floor(centres_m / edge_m).astype(np.int64).astype(np.uint64)
    mixed = place[:, 0] * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ place[:, 1]) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(29)) ^ place[:, 2]) * np.uint64(0x94D049BB133111EB)
    return np.flatnonzero((mixed >> np.uint64(33)) % np.uint64(every) == 0)


def roc_area(log_odds: Floats, solid: Bools) -> float:
    """Chance that a solid voxel has more than a free one, equal ones half; NaN without either.

    Mann and Whitney's U, from the ranks.
    """
    solids, frees = int(solid.sum()), int((~solid).sum())
    if not (solids and frees):
        return float("nan")
    _, place, counts = np.unique(log_odds, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2.0)[place]
    return float((ranks[solid].sum() - solids * (solids + 1) / 2.0) / (solids * frees))


@dataclass(frozen=True, slots=True)
class Reliability:
    """How often voxels of a probability are solid, in bins of a tenth.

    Attributes:
        counts: voxels of each bin.
        said: their mean probability, NaN in an empty bin.
        solid: share of them that is solid, NaN in an empty bin.
        expected: difference of both, mean over the voxels.
        worst: largest difference of a bin of at least 100 voxels.
    """

    counts: NDArray[np.int64]
    said: Floats
    solid: Floats
    expected: float
    worst: float


def reliability(log_odds: Floats, solid: Bools) -> Reliability:
    """Compare said probabilities with what is true."""
    probability = 1.0 / (1.0 + np.exp(-np.asarray(log_odds, dtype=np.float64)))
    place = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    with np.errstate(invalid="ignore"):
        said = np.bincount(place, weights=probability, minlength=BINS) / counts
        share = np.bincount(place, weights=solid, minlength=BINS) / counts
    off = np.abs(said - share)
    enough = counts >= LEAST_IN_BIN
    expected = float(np.nansum(off * counts) / max(len(log_odds), 1))
    worst = float(off[enough].max()) if enough.any() else float("nan")
    return Reliability(counts, said, share, expected, worst)
