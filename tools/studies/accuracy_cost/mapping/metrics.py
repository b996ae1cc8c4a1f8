"""What a map is worth beside the truth: distances, F-scores, ROC area, calibration.

All of it is float64 NumPy on plain arrays, so that it can be checked by hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = [
    "BINS",
    "Floor",
    "Pile",
    "Reliability",
    "Solid",
    "SolidBox",
    "Solids",
    "Surfaces",
    "reliability",
    "roc_area",
    "sampled",
    "surfaces",
]


Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

FLOOR_CELL_M = 0.25
FACETS = 64


class Solid(Protocol):
    """Something that echoes."""

    def distance_m(self, points_m: Floats) -> Floats:
        """Signed distance (N,) of points (N, 3) to its surface, negative inside."""

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Vertices (V, 3) and faces (F, 3)."""


@dataclass(frozen=True, slots=True)
class Floor:
    """The sea's floor: all below long, low swells.

    Attributes:
        depth_m: of its mean.
        swell_m: amplitude of the larger swell; the smaller is half of it.
        half_m: half the edge of the part that the simulator hears.
        middle_m: of that part, x and y.
    """

    depth_m: float
    swell_m: float = 0.1
    half_m: float = 20.0
    middle_m: tuple[float, float] = (0.0, 0.0)

    def height_m(self, x_m: Floats, y_m: Floats) -> Floats:
        """Above the map's zero."""
        large = np.sin(0.6 * x_m + 0.3) * np.cos(0.45 * y_m)
        small = np.sin(1.2 * y_m + 0.7 * x_m)
        return np.asarray(self.swell_m * (large + 0.5 * small) - self.depth_m)

    def distance_m(self, points_m: Floats) -> Floats:
        """Height over the floor, by the slope under the point."""
        x, y, z = points_m.T
        along_x = 0.6 * np.cos(0.6 * x + 0.3) * np.cos(0.45 * y)
        along_x += 0.35 * np.cos(1.2 * y + 0.7 * x)
        along_y = -0.45 * np.sin(0.6 * x + 0.3) * np.sin(0.45 * y)
        along_y += 0.6 * np.cos(1.2 * y + 0.7 * x)
        slope = self.swell_m**2 * (along_x**2 + along_y**2)
        return np.asarray((z - self.height_m(x, y)) / np.sqrt(1.0 + slope))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """A sheet."""
        across = np.linspace(-self.half_m, self.half_m, round(2 * self.half_m / FLOOR_CELL_M) + 1)
        x, y = np.meshgrid(across + self.middle_m[0], across + self.middle_m[1], indexing="ij")
        vertices = np.stack([x, y, self.height_m(x, y)], axis=-1).reshape(-1, 3)
        index = np.arange(x.size).reshape(x.shape)
        a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
        c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        return vertices, faces


@dataclass(frozen=True, slots=True)
class SolidBox:
    """Along the map's axes."""

    middle_m: Triple
    edges_m: Triple

    def distance_m(self, points_m: Floats) -> Floats:
        """Exact, inside as well."""
        beyond = np.abs(points_m - self.middle_m) - np.divide(self.edges_m, 2.0)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Twelve triangles."""
        return _moved(trimesh.creation.box(extents=self.edges_m), self.middle_m)


@dataclass(frozen=True, slots=True)
class Pile:
    """An upright cylinder with its ends."""

    middle_m: Triple
    radius_m: float
    height_m: float

    def distance_m(self, points_m: Floats) -> Floats:
        """Exact, inside as well."""
        off = points_m - self.middle_m
        aside = np.hypot(off[:, 0], off[:, 1]) - self.radius_m
        beyond = np.stack([aside, np.abs(off[:, 2]) - self.height_m / 2.0], axis=1)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    def mesh(self) -> tuple[Floats, NDArray[np.int64]]:
        """Its facets lie within a thousandth of the radius of the cylinder."""
        tube = trimesh.creation.cylinder(self.radius_m, self.height_m, sections=FACETS)
        return _moved(cast("trimesh.Trimesh", tube), self.middle_m)


@dataclass(frozen=True, slots=True)
class Solids:
    """All solids of a dive."""

    solids: Sequence[Solid]

    def distance_m(self, points_m: Floats) -> Floats:
        """Signed distance (N,) of points (N, 3) to the nearest surface, negative inside a solid.

        Inside two solids at once the depth is that of the deeper one.
        """
        nearest = np.full(len(points_m), np.inf)
        for solid in self.solids:
            np.minimum(nearest, solid.distance_m(points_m), out=nearest)
        return nearest

    def touched(self, centres_m: Floats, edge_m: float, samples: int = 5) -> NDArray[np.bool_]:
        """Which voxels (N,) hold a part of a solid, of centres (N, 3).

        Where the distance of the centre does not decide it, the voxel is looked at in a lattice of
        `samples`³ points, its faces and corners among them: what reaches less than a quarter of an
        edge into it may be missed.
        """
        distance = self.distance_m(centres_m)
        touched = distance <= 0.0
        doubtful = np.flatnonzero((distance > 0.0) & (distance < np.sqrt(0.75) * edge_m))
        steps = np.linspace(-0.5, 0.5, samples) * edge_m
        offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        reached = np.zeros(len(doubtful), dtype=np.bool_)
        for offset in offsets[np.argsort(-np.abs(offsets).sum(axis=1))]:
            left = np.flatnonzero(~reached)
            reached[left] = self.distance_m(centres_m[doubtful[left]] + offset) <= 0.0
        touched[doubtful] = reached
        return touched


def _moved(mesh: trimesh.Trimesh, middle_m: Triple) -> tuple[Floats, NDArray[np.int64]]:
    vertices = np.asarray(mesh.vertices, dtype=np.float64) + middle_m
    return vertices, np.asarray(mesh.faces, dtype=np.int64)


Bools = NDArray[np.bool_]

BINS = 10
NEAR_VOXELS = 1.5
"""A voxel that holds a surface has its centre up to 0.87 edges from it, a neighbour 1.5."""
NEAR_M = 0.15
FALSE_M = 0.25
CAP_M = 0.5
"""Wrong is wrong: how far beyond this does not count any more."""
MIN_IN_BIN = 100
"""Voxels; a bin with fewer does not count."""
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


def surfaces(world: Solids, seen_m: Floats, occupied_m: Floats, edge_m: float) -> Surfaces:
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
        probability: their mean, NaN in an empty bin.
        solid: share of them that is solid, NaN in an empty bin.
        expected: difference of both, mean over the voxels.
        worst: largest difference of a bin of at least 100 voxels.
    """

    counts: NDArray[np.int64]
    probability: Floats
    solid: Floats
    expected: float
    worst: float


def reliability(log_odds: Floats, solid: Bools) -> Reliability:
    """Compare probabilities with what is true."""
    probability = 1.0 / (1.0 + np.exp(-np.asarray(log_odds, dtype=np.float64)))
    place = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(place, weights=probability, minlength=BINS) / counts
        share = np.bincount(place, weights=solid, minlength=BINS) / counts
    off = np.abs(mean - share)
    enough = counts >= MIN_IN_BIN
    expected = float(np.nansum(off * counts) / max(len(log_odds), 1))
    worst = float(off[enough].max()) if enough.any() else float("nan")
    return Reliability(counts, mean, share, expected, worst)
