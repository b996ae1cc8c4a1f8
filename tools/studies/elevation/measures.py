"""What a map of a dive is worth: the truth as voxels, and the figures.

The truth of a scene is a grid of the map's own voxels, made from the triangles:

- A voxel is *touched* if it holds a point of a surface, its own faces included. Surfaces are
  sampled every fifth of an edge, so a corner that reaches in by less may be missed.
- It is *solid* if it is touched, or if no way of untouched voxels (over their faces) leads to it
  from a sonar: the inside of bodies, the ground, and the air above a sea surface. Beyond the edge
  of the floor, where nothing closes the water, only touched voxels are solid.
- The distance of its centre to the nearest surface comes from the same samples, which make it too
  large by up to 5 mm, and is rounded down to 5 mm; 0.5 m and more are 0.5 m. So a centre 0.25 m
  off a wall along the grid is not farther than that.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter
from scipy.spatial import cKDTree
from sonar_sim import Scene

from mapperd.mapping.sonar_map import SonarMap
from studies.accuracy_cost.mapping.dives import once
from studies.accuracy_cost.mapping.metrics import (
    CAP_M,
    FALSE_M,
    NEAR_VOXELS,
    Solids,
    reliability,
    roc_area,
    surfaces,
)
from studies.elevation.dives import Dive, DiveData, cell_keys

__all__ = [
    "CURVE_LOG_ODDS",
    "ChangeWatch",
    "Sweep",
    "TrueGrid",
    "log_loss",
    "measure",
    "surface_points",
    "sweep",
    "true_grid",
    "truth_of",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STEPS_AN_EDGE = 5
PIECE_STEPS = 12
"""Triangles are cut until none is longer than so many steps."""
MAX_POINTS = 1_000_000
"""Of a part of the samples, about."""
THIN_M, NEAR_THIN_M = 0.02, 0.01
"""Of samples so near to each other one is kept for the distances: twice as fine below `FINE_M`."""
FINE_M = 0.15
ROUND_M = 0.005
TOUCH_M = 1e-6
MARGIN_M = 1.5
"""Around all fans of a dive: the jitter of its seeds and errors of poses."""
HALF_BEARING_RAD, HALF_ELEVATION_RAD = math.radians(65.0), math.radians(20.0)
FAN_RAD = math.radians(10.0)
"""A ping sees what lies within this elevation."""
SEES = 0.25
SAME_M = 0.01
GONE, SHOWN = 0.1, 0.5
FREED_PINGS = 5
CURVE_LOG_ODDS = np.arange(-8.0, 8.1, 0.2)
"""Edges of bins from which probabilities are calibrated; the outer ones hold what lies beyond."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueGrid(Solids):
    """The truth in voxels, as the solids that `metrics.surfaces` asks.

    Attributes:
        edge_m: of a voxel.
        low: (3,) index of the first voxel; voxel k spans k..k + 1 times the edge.
        distance: (X, Y, Z) float16, metres from the centre to the nearest surface, at most 0.5.
        solid: (X, Y, Z), which voxels are solid.
    """

    edge_m: float
    low: Ints
    distance: NDArray[np.float16]
    solid: Bools

    def place(self, points_m: Floats) -> tuple[Ints, Ints, Ints]:
        """Index of the voxels that hold the points (N, 3).

        Raises:
            ValueError: a point lies outside of the grid.
        """
        index = np.floor(points_m / self.edge_m).astype(np.int64) - self.low
        if len(index) and not ((index >= 0) & (index < self.solid.shape)).all():
            raise ValueError("a voxel lies outside of the dive's truth: remove its file")
        return index[:, 0], index[:, 1], index[:, 2]

    def distance_m(self, points_m: Floats) -> Floats:
        """Distance (N,) of the centres of the voxels that hold the points (N, 3)."""
        return self.distance[self.place(points_m)].astype(np.float64)

    def touched(self, centres_m: Floats, edge_m: float, samples: int = 5) -> Bools:
        """Which voxels (N,) of centres (N, 3) are solid; edge and samples are the grid's own."""
        del edge_m, samples
        return self.solid[self.place(centres_m)]


def surface_points(triangles_m: Floats, step_m: float) -> Iterator[Floats]:
    """Points (N, 3) on triangles (F, 3, 3), none farther than a step from the next; in parts."""
    pieces, longest_m = triangles_m, PIECE_STEPS * step_m
    while True:
        edges_m = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=2)
        turn = (edges_m.argmax(axis=1)[:, None] + np.arange(3)) % 3
        pieces = np.take_along_axis(pieces, turn[:, :, None], axis=1)  # the longest edge is a to b
        long = edges_m.max(axis=1) > longest_m
        if not long.any():
            break
        a, b, c = pieces[long].transpose(1, 0, 2)
        halves = np.stack([a, (a + b) / 2, c], axis=1), np.stack([(a + b) / 2, b, c], axis=1)
        pieces = np.concatenate([pieces[~long], *halves])
    counts = np.maximum(np.ceil(edges_m.max(axis=1) / step_m), 1).astype(int)
    for n in np.unique(counts):
        i, j = (v.ravel() for v in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
        inside = i + j <= n
        weights = np.stack([i, j, n - i - j], axis=1)[inside] / n
        alike, at_once = pieces[counts == n], MAX_POINTS // len(weights) + 1
        for first in range(0, len(alike), at_once):
            some = alike[first : first + at_once]
            yield np.einsum("pk,fkd->fpd", weights, some).reshape(-1, 3)


def true_grid(
    triangles_m: Floats, edge_m: float, box_m: Floats, dry_m: Floats, wet_m: Floats
) -> TrueGrid:
    """Make the truth from triangles.

    Args:
        triangles_m: (F, 3, 3), map frame.
        edge_m: of a voxel.
        box_m: (2, 3) corners of the grid.
        dry_m: (2, 2) corners in x and y within which floor or walls close the water.
        wet_m: (N, 3) points in the water.
    """
    low = np.floor(box_m[0] / edge_m).astype(np.int64)
    shape = tuple(np.floor(box_m[1] / edge_m).astype(np.int64) - low + 1)
    touched = np.zeros(shape, dtype=np.bool_)
    step_m, samples = edge_m / STEPS_AN_EDGE, []
    for points_m in surface_points(_near(triangles_m, box_m), step_m):
        for side_m in (-TOUCH_M, TOUCH_M):
            index = np.floor((points_m + side_m) / edge_m).astype(np.int64) - low
            index = index[((index >= 0) & (index < shape)).all(axis=1)]
            touched[tuple(index.T)] = True
        samples.append(_thinned(points_m, NEAR_THIN_M))
    distance = np.full(shape, CAP_M, dtype=np.float16)
    if samples:
        reach = math.ceil(CAP_M / edge_m) + 1
        near = np.nonzero(maximum_filter(touched, size=2 * reach + 1))
        centres_m = (np.stack(near, axis=1) + low + 0.5) * edge_m
        found_m = _to_samples(centres_m, np.concatenate(samples))
        distance[near] = np.minimum(ROUND_M * np.floor(found_m / ROUND_M + TOUCH_M), CAP_M)
    solid = touched | _dry(touched, low, edge_m, dry_m, wet_m)
    return TrueGrid((), edge_m, low, distance, solid)


def _to_samples(points_m: Floats, samples_m: Floats) -> Floats:
    """Distance (N,) of points (N, 3) to the nearest sample (M, 3)."""
    found_m: Floats = _tree(_thinned(samples_m, THIN_M)).query(points_m)[0]
    close = found_m < FINE_M
    found_m[close] = _tree(samples_m).query(points_m[close])[0]
    return found_m


def _tree(points_m: Floats) -> cKDTree:
    """The points lie on lattices: balancing a tree of so many equal coordinates takes minutes."""
    return cKDTree(points_m, balanced_tree=False, compact_nodes=False)


def _thinned(points_m: Floats, cell_m: float) -> Floats:
    """One of the points (N, 3) a cell."""
    first = np.unique(cell_keys(points_m, cell_m), return_index=True)[1]
    return np.asarray(points_m[first])


def _near(triangles_m: Floats, box_m: Floats) -> Floats:
    """Triangles that may reach into the box."""
    below, above = triangles_m.min(axis=1), triangles_m.max(axis=1)
    near = (above >= box_m[0] - CAP_M) & (below <= box_m[1] + CAP_M)
    return np.asarray(triangles_m[near.all(axis=1)])


def _dry(touched: Bools, low: Ints, edge_m: float, dry_m: Floats, wet_m: Floats) -> Bools:
    """Untouched voxels that no water reaches."""
    first = np.clip(np.ceil(dry_m[0] / edge_m).astype(int) - low[:2], 0, None)
    last = np.clip(np.floor(dry_m[1] / edge_m).astype(int) - low[:2], 0, None)
    closed = np.s_[first[0] : last[0], first[1] : last[1]]
    regions, _ = label(~touched[closed])
    start = np.floor(wet_m / edge_m).astype(np.int64) - low - [*first, 0]
    start = start[((start >= 0) & (start < regions.shape)).all(axis=1)]
    wet = np.unique(regions[tuple(start.T)])
    dry = np.zeros_like(touched)
    dry[closed] = ~touched[closed] & ~np.isin(regions, wet[wet > 0])
    return dry


def truth_of(dive: Dive, edge_m: float, folder: Path, *, changed: bool = True) -> TrueGrid:
    """The truth of a dive from its file, which is made if it is not there.

    Args:
        dive: which.
        edge_m: of a voxel.
        folder: of the files.
        changed: whether the scene is that after its change, if it has one.
    """
    name = "" if changed or dive.change is None else "-before"
    path = folder / f"truth-{dive.name}{name}-{1000 * edge_m:g}mm.npz"
    if not path.exists():
        scene = dive.change.scene() if changed and dive.change is not None else dive.scene()
        poses = dive.poses(0)
        box_m = _box_of_fans(poses, dive.range_m)
        floor = scene.surfaces[0].vertices_m[:, :2]
        dry_m = np.stack([floor.min(axis=0), floor.max(axis=0)])
        triangles_m = np.concatenate([scene.triangles_m, _sea(scene, box_m)])
        grid = true_grid(triangles_m, edge_m, box_m, dry_m, poses[:, :3, 3])
        folder.mkdir(parents=True, exist_ok=True)
        part = once(path)
        with part.open("wb") as file:
            np.savez_compressed(file, low=grid.low, distance=grid.distance, solid=grid.solid)
        part.rename(path)
    with np.load(path) as archive:
        return TrueGrid((), edge_m, archive["low"], archive["distance"], archive["solid"])


def _box_of_fans(poses: Floats, range_m: float) -> Floats:
    """Corners (2, 3) of a box around all that the sonar may hear, with a margin."""
    bearing, elevation = np.meshgrid(
        np.linspace(-HALF_BEARING_RAD, HALF_BEARING_RAD, 9),
        np.linspace(-HALF_ELEVATION_RAD, HALF_ELEVATION_RAD, 5),
    )
    ends = np.stack(
        [
            np.cos(elevation) * np.cos(bearing),
            -np.cos(elevation) * np.sin(bearing),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ends = range_m * np.concatenate([np.zeros((1, 3)), ends])
    points_m = np.einsum("nij,pj->npi", poses[:, :3, :3], ends) + poses[:, None, :3, 3]
    return np.stack([points_m.min(axis=(0, 1)) - MARGIN_M, points_m.max(axis=(0, 1)) + MARGIN_M])


def _sea(scene: Scene, box_m: Floats) -> Floats:
    """The sea's surface over the box, (2, 3, 3), if the scene has one."""
    if scene.sea is None:
        return np.empty((0, 3, 3))
    (x0, y0), (x1, y1) = box_m[:, :2]
    a, b, c, d = (x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)
    return np.array([[a, b, c], [a, c, d]])


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """F-scores over the threshold.

    Attributes:
        log_odds: (T,) thresholds; voxels above are occupied.
        f_one, f_two: (T,) F-scores within one and within two edges.
        false_share: (T,) of the occupied voxels, farther than 0.25 m from any surface.
    """

    log_odds: Floats
    f_one: Floats
    f_two: Floats
    false_share: Floats


SWEPT = np.arange(-6.0, 10.0, 0.05)


def sweep(truth: TrueGrid, seen_m: Floats, centres_m: Floats, log_odds: Floats) -> Sweep:
    """F-scores of a map at all thresholds.

    Args:
        truth: of the scene.
        seen_m: (M, 3) points of the surface in sight.
        centres_m: (N, 3) of all observed voxels.
        log_odds: (N,) of them.
    """
    off_m = truth.distance_m(centres_m)
    above = _count_above(log_odds)
    scores = []
    for edges in (1, 2):
        within_m = edges * truth.edge_m
        loudest = _largest_near(truth, seen_m, centres_m, log_odds, edges)
        with np.errstate(invalid="ignore"):
            right = _count_above(log_odds[off_m <= within_m]) / above
            found = _count_above(loudest) / len(seen_m)
            scores.append(np.nan_to_num(2.0 * right * found / (right + found)))
    with np.errstate(invalid="ignore"):
        false_share = _count_above(log_odds[off_m > FALSE_M]) / above
    return Sweep(SWEPT, scores[0], scores[1], false_share)


def _count_above(values: Floats) -> Floats:
    """How many values (N,) lie above each threshold, (T,)."""
    return (len(values) - np.searchsorted(np.sort(values), SWEPT, side="right")).astype(np.float64)


def _largest_near(
    truth: TrueGrid, seen_m: Floats, centres_m: Floats, log_odds: Floats, edges: int
) -> Floats:
    """Largest log-odds (M,) of a voxel whose centre lies within so many edges of each point."""
    held = np.full(np.add(truth.solid.shape, 2 * edges), -np.inf)
    x, y, z = truth.place(centres_m)
    held[x + edges, y + edges, z + edges] = log_odds
    base = np.floor(seen_m / truth.edge_m).astype(np.int64)
    part = seen_m / truth.edge_m - base
    base += edges - truth.low
    largest = np.full(len(seen_m), -np.inf)
    for offset in np.ndindex(*(3 * (2 * edges + 1,))):
        step = np.array(offset) - edges
        near = ((step + 0.5 - part) ** 2).sum(axis=1) <= edges**2
        here = held[tuple((base[near] + step).T)]
        largest[near] = np.maximum(largest[near], here)
    return largest


def log_loss(log_odds: Floats, solid: Bools) -> float:
    """Mean of -log p of what is true, in nats."""
    return float(np.logaddexp(0.0, np.where(solid, -log_odds, log_odds)).mean())


class ChangeWatch:
    """Follows the object that is removed and the one that is put there, ping by ping.

    A ping sees an object's place if a quarter of the object's points in sight lie in its fan
    (±65°, ±10°, within its range). Gone: less than a tenth of as many of its voxels (solid before,
    not solid afterwards) are occupied as just before the change. Shown: more than half of its
    points have an occupied voxel's centre within 1.5 edges. Of the new object those points count
    that at least `FREED_PINGS` fans reached before the change, when there was water.

    Args:
        dive: one with a change.
        data: of it.
        edge_m: of a voxel.
        folder: of the truth's files.
    """

    def __init__(self, dive: Dive, data: DiveData, edge_m: float, folder: Path) -> None:
        if dive.change is None:
            raise ValueError(f"nothing changes in {dive.name}")
        self._change, self._data, self._edge_m = dive.change, data, edge_m
        self._after = truth_of(dive, edge_m, folder)
        self._freed = truth_of(dive, edge_m, folder, changed=False).solid & ~self._after.solid
        earlier = data.seen_ping < dive.change.ping
        on_removed = earlier & (np.abs(dive.change.removed.distance_m(data.seen_m)) < SAME_M)
        on_added = ~earlier & (np.abs(dive.change.added.distance_m(data.seen_m)) < SAME_M)
        added_m = data.seen_m[on_added]
        before = sum(self._in_fan(ping, added_m).astype(int) for ping in range(dive.change.ping))
        self._places_m = {"gone": data.seen_m[on_removed], "shown": added_m[before >= FREED_PINGS]}
        self.staying_m = data.seen_m[~on_removed]
        """Points in sight that are there at the end, (M, 3)."""
        self._looks = {"gone": 0, "shown": 0}
        self._share = {"gone": math.nan, "shown": 0.0}
        self._done: dict[str, int] = {}
        self._before = 0
        self._shown_before = dict.fromkeys(self._places_m, math.nan)

    def __call__(self, ping: int, sonar_map: SonarMap) -> None:
        """Look at the map after a ping."""
        if ping < self._change.ping - 1:
            return
        occupied_m = sonar_map.occupied().centres_m
        still = int(self._freed[self._after.place(occupied_m)].sum())
        tree = cKDTree(occupied_m)
        near = {name: self._near(points_m, tree) for name, points_m in self._places_m.items()}
        if ping == self._change.ping - 1:
            self._before, self._shown_before = still, near
            return
        gone = still / self._before if self._before else math.nan
        self._share = {"gone": gone, "shown": near["shown"]}
        for name, points_m in self._places_m.items():
            seen = self._in_fan(ping, points_m)
            self._looks[name] += len(seen) > 0 and float(seen.mean()) >= SEES
            is_done = gone < GONE if name == "gone" else near[name] > SHOWN
            if is_done and name not in self._done:
                self._done[name] = self._looks[name]

    def look_again(self, sonar_map: SonarMap) -> None:
        """Look at the final map, which no ping has changed."""
        occupied_m = sonar_map.occupied().centres_m
        still = int(self._freed[self._after.place(occupied_m)].sum())
        self._share = {
            "gone": still / self._before if self._before else math.nan,
            "shown": self._near(self._places_m["shown"], cKDTree(occupied_m)),
        }

    def _near(self, points_m: Floats, occupied: cKDTree) -> float:
        if len(points_m) == 0:
            return 0.0
        gap_m, _ = occupied.query(points_m)
        return float(np.mean(gap_m <= NEAR_VOXELS * self._edge_m))

    def _in_fan(self, ping: int, points_m: Floats) -> Bools:
        pose = self._data.map_T_sonar[ping]
        x, y, z = ((points_m - pose[:3, 3]) @ pose[:3, :3]).T
        range_m = np.sqrt(x**2 + y**2 + z**2)
        in_fan = (x > 0) & (np.abs(y) <= np.sin(HALF_BEARING_RAD) * range_m)
        in_fan &= (np.abs(z) <= np.sin(FAN_RAD) * range_m) & (range_m < self._data.max_range_m)
        return np.asarray(in_fan)

    def figures(self) -> dict[str, float]:
        """Pings that saw the place until gone and until shown (NaN: never), and shares.

        `..._share` are those at the end, `..._looks` all pings that saw the place. Just before the
        change, `removed_before` and `added_before` are the shares of the objects' points near an
        occupied voxel.
        """
        return {
            "gone_pings": float(self._done.get("gone", math.nan)),
            "gone_share": self._share["gone"],
            "gone_looks": float(self._looks["gone"]),
            "shown_pings": float(self._done.get("shown", math.nan)),
            "shown_share": self._share["shown"],
            "shown_looks": float(self._looks["shown"]),
            "removed_before": self._shown_before["gone"],
            "added_before": self._shown_before["shown"],
        }


def measure(
    truth: TrueGrid, seen_m: Floats, sonar_map: SonarMap, common: Bools | None = None
) -> dict[str, object]:
    """Compare a map with the truth.

    F-scores, false share and completeness are those of `metrics.surfaces`, of the occupied voxels
    by the map's own threshold; points in sight count once a cell of half an edge, so that near
    surfaces weigh no more than far ones. `best_...` are over all thresholds. ROC area, log-loss and
    calibration are over all observed voxels; `..._common` over the voxels of `common`, where an
    unobserved one has p = 0.5.

    Args:
        truth: of the scene.
        seen_m: (M, 3) points of its surface in sight.
        sonar_map: the map.
        common: (X, Y, Z), which voxels of the truth's grid are compared for all contenders.
    """
    edge_m = truth.edge_m
    seen_m = _thinned(seen_m, edge_m / 2)
    occupied_m = sonar_map.occupied().centres_m
    centres_m, held, _ = sonar_map.core.voxels()
    log_odds = held.astype(np.float64)
    solid = truth.touched(centres_m, edge_m)
    scores = sweep(truth, seen_m, centres_m, log_odds)
    best = int(scores.f_one.argmax())
    bins = reliability(log_odds, solid)
    inside = np.clip(log_odds, CURVE_LOG_ODDS[0], CURVE_LOG_ODDS[-1])
    row: dict[str, object] = {
        **asdict(surfaces(truth, seen_m, occupied_m, edge_m)),
        "best_f_one": float(scores.f_one[best]),
        "best_f_two": float(scores.f_two.max()),
        "best_log_odds": float(scores.log_odds[best]),
        "best_false_share": float(scores.false_share[best]),
        "roc_area": roc_area(log_odds, solid),
        "log_loss": log_loss(log_odds, solid),
        "calibration_worst": bins.worst,
        "calibration_expected": bins.expected,
        "bin_voxels": bins.counts.tolist(),
        "bin_probability": bins.probability.tolist(),
        "bin_solid": bins.solid.tolist(),
        "curve_voxels": np.histogram(inside, CURVE_LOG_ODDS)[0].tolist(),
        "curve_solid": np.histogram(inside[solid], CURVE_LOG_ODDS)[0].tolist(),
        "observed": len(log_odds),
        "occupied": len(occupied_m),
    }
    if common is not None:
        held_there = np.zeros(truth.solid.shape)
        held_there[truth.place(centres_m)] = log_odds
        row["roc_area_common"] = roc_area(held_there[common], truth.solid[common])
        row["log_loss_common"] = log_loss(held_there[common], truth.solid[common])
    return row
