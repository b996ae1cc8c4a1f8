"""Finds registrations between submaps: which pairs to try, where to look, and what to believe."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mapperd._core import Registration, Submap, compare_submaps, register_submaps, search_poses
from mapperd.alignment.pose_graph import MIN_INFORMATION, Loop, PoseGraph
from mapperd.alignment.submaps import (
    MIN_FRAGMENT_VOXELS,
    MIN_VOXELS,
    SonarSubmap,
    compose,
    inverse,
)

__all__ = [
    "LoopFinder",
    "Pair",
    "Trial",
    "joined_submap",
    "register_dives",
    "usable_information",
]

Floats = NDArray[np.float64]

KEPT_SUBMAPS = 64
"""Submaps whose distances are in memory at the same time."""

NEIGHBOURS = (2,)
"""Each fragment is registered to the one this many before it. Adjacent ones share only echoes of
their common end, which do not show drift."""

LOOP_S = 25.0
"""Time between the submaps of a revisit, at least."""

GATE = 16.3
"""Squared Mahalanobis distance from the prediction, 3 degrees of freedom, 99.9 %."""

SIGMAS = 2.5
MIN_HALF_M, MAX_HALF_M = 0.6, 6.0
LOOP_NOISE = np.array([0.8, 0.8, math.radians(2.0)])
"""Standard deviations (m, m, rad) that predictions of revisits are widened by: one wrong
registration must not hide the right ones."""

MAX_NEIGHBOUR_M = 0.8
"""Largest standard deviation, m, of a prediction between submaps that follow each other. What moves
with the vehicle, such as the near edge of the floor, looks the same a few metres further."""

MIN_HALF_RAD, MAX_HALF_RAD = math.radians(4.0), math.radians(20.0)
STEP_M, STEP_RAD = 0.4, math.radians(2.5)
CANDIDATES = 4

MIN_SCORE = 0.55
MIN_MATCHED, MIN_MATCHED_NEIGHBOUR = 0.35, 0.2
PRIOR_WEIGHT = 0.01
"""Score that a candidate loses for each unit of squared distance from the prediction."""

RIVAL_SHARE = 0.9
"""Alternatives whose score is at least this share of the best one's are kept."""

APART_M, APART_RAD = 0.3, math.radians(2.0)
"""Alternatives closer than this are the same."""

MIN_STD_M, MIN_STD_RAD = 0.05, math.radians(0.4)
FULL_SHARE, UNMATCHED_GROWTH = 0.7, 7.0
MIN_STD_NEIGHBOUR_M, MIN_STD_NEIGHBOUR_RAD, NEIGHBOUR_FULL_SHARE = 0.1, math.radians(1.0), 0.3
TURN_M, TURN_RAD = 0.1, math.radians(1.2)
"""Standard deviation of every registration, for odometry drifts within a submap. It grows
exponentially as the matched share falls below `FULL_SHARE`, and by so much for each radian between
the headings: echoes of unknown elevation are spread over arcs, and submaps that see a thing from
different places, or different parts of it, disagree about its middle by some percent."""

PROBE_M, PROBE_POINTS = 0.5, 800
MIN_SCORE_DROP = 0.04
"""A direction along which the agreement falls by less than this share over `PROBE_M` is open."""

FRAME_HALF_M, FRAME_HALF_RAD = 12.0, math.radians(45.0)
FRAME_STEP_M, FRAME_STEP_RAD = 0.5, math.radians(3.0)
FRAME_CANDIDATES = 8
MAX_VOXELS, MARGIN_M = 3e7, 5.0
"""Size of the map of a whole dive in voxels, with a margin."""

MIN_FRAME_SCORE, MIN_FRAME_MATCHED, FRAME_RIVAL_SHARE = 0.6, 0.3, 0.9
"""What the registration of two whole dives must reach, and the share of its score that any other
place must stay below."""

LEVER_M = 5.0
"""Distance at which a turn counts as a shift, to compare curvatures."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two submaps to register: indices of target and source."""

    i: int
    j: int
    neighbours: bool


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A pair with the prediction to look around: i_T_j, (3,), and its covariance, (3, 3)."""

    pair: Pair
    prediction: Floats
    covariance: Floats


@dataclass(eq=False)
class LoopFinder:
    """Registers submaps of one or more dives.

    Args:
        submaps: all of them.
        nodes: index of the graph's node of each submap.
        threads: that register pairs at the same time; results do not depend on it.
        dive_of: dive of each submap. With it only revisits between dives are sought.

    Attributes:
        tried: number of registered pairs.
        rejected: pairs without a loop, by reason.
    """

    submaps: Sequence[SonarSubmap]
    nodes: Sequence[int]
    threads: int = 2
    dive_of: Sequence[int] = ()
    tried: int = 0
    rejected: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._built: Callable[[int], Submap] = lru_cache(KEPT_SUBMAPS)(self._build)

    def _build(self, index: int) -> Submap:
        return self.submaps[index].build()

    def neighbours(self) -> list[Pair]:
        """Pairs that follow each other, of fragments."""
        return [
            Pair(j - back, j, neighbours=True)
            for j in range(len(self.submaps))
            for back in NEIGHBOURS
            if j >= back and self._follow(self.submaps[j - back], self.submaps[j])
        ]

    def _follow(self, a: SonarSubmap, b: SonarSubmap) -> bool:
        enough = min(len(a.occupied), len(b.occupied)) >= MIN_FRAGMENT_VOXELS
        return enough and a.segment == b.segment and (b.begin_ns - a.end_ns) / 1e9 < LOOP_S

    def loops(self, graph: PoseGraph, known: Iterable[Pair], per_submap: int) -> list[Trial]:
        """Pairs of revisits that the graph predicts, the best predicted first.

        Args:
            graph: whose covariances are prepared.
            known: pairs not to try again.
            per_submap: number of partners of a submap.
        """
        skip = {(pair.i, pair.j) for pair in known}
        usable = [k for k, one in enumerate(self.submaps) if len(one.occupied) >= MIN_VOXELS]
        ranked: list[tuple[float, Trial]] = []
        for i in usable:
            others = [j for j in usable if self._is_revisit(i, j) and (i, j) not in skip]
            if not others:
                continue
            node, nodes = self.nodes[i], [self.nodes[j] for j in others]
            relative = compose(inverse(graph.poses[node])[None], graph.poses[nodes])
            covariances = graph.covariance_of(node, nodes)
            for j, predicted, covariance in zip(others, relative, covariances, strict=True):
                quality = self._quality(i, j, predicted, covariance)
                if quality > 0:
                    pair = Pair(i, j, neighbours=False)
                    widened = covariance + np.diag(LOOP_NOISE**2)
                    ranked.append((quality, Trial(pair, predicted, widened)))
        ranked.sort(key=lambda one: -one[0])
        count = np.zeros(len(self.submaps), dtype=np.intp)
        chosen = []
        for _, trial in ranked:
            ends = [trial.pair.i, trial.pair.j]
            if count[ends].min() < per_submap and count[ends].max() < 2 * per_submap:
                count[ends] += 1
                chosen.append(trial)
        return chosen

    def _is_revisit(self, i: int, j: int) -> bool:
        a, b = self.submaps[i], self.submaps[j]
        if self.dive_of:
            return j > i and self.dive_of[i] != self.dive_of[j]
        return j > i and (b.begin_ns - a.end_ns) / 1e9 >= LOOP_S

    def _quality(self, i: int, j: int, predicted: Floats, covariance: Floats) -> float:
        """Predicted overlap, less for an uncertain prediction; 0 for a pair that is not tried."""
        a, b = self.submaps[i], self.submaps[j]
        c, s = math.cos(predicted[2]), math.sin(predicted[2])
        centre_m = predicted[:2] + np.array([[c, -s], [s, c]]) @ b.centre_m
        apart_m = float(np.hypot(*(centre_m - a.centre_m)))
        reach_m = max(min(a.radius_m, b.radius_m), 1.0)
        spread_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
        if SIGMAS * spread_m > MAX_HALF_M or apart_m > 1.5 * reach_m + spread_m:
            return 0.0
        return math.exp(-((apart_m / reach_m) ** 2)) / (1.0 + spread_m)

    def register(self, trials: Sequence[Trial]) -> list[Loop]:
        """Register pairs; return the loops that can be believed, in the order of the pairs."""
        loops: list[Loop] = []
        with ThreadPoolExecutor(self.threads) as pool:
            for found in pool.map(self._register, trials):
                self.tried += 1
                if isinstance(found, str):
                    self.rejected[found] += 1
                else:
                    loops.append(found)
        return loops

    def _register(self, trial: Trial) -> Loop | str:
        """Return a loop, or the reason why there is none."""
        pair, predicted = trial.pair, trial.prediction
        target, source = self._built(pair.i), self._built(pair.j)
        covariance = trial.covariance
        if pair.neighbours:
            limit = min(1.0, MAX_NEIGHBOUR_M / math.sqrt(float(covariance[:2, :2].trace()) / 2))
            units = np.array([limit, limit, 1.0])
            covariance = units[:, None] * covariance * units
        sigma = np.sqrt(np.diag(covariance))
        half_m = np.clip(SIGMAS * sigma[:2], MIN_HALF_M, MAX_HALF_M)
        half_rad = float(np.clip(SIGMAS * sigma[2], MIN_HALF_RAD, MAX_HALF_RAD))
        starts = search_poses(
            target,
            source,
            predicted,
            half_x_m=float(half_m[0]),
            half_y_m=float(half_m[1]),
            half_yaw_rad=half_rad,
            step_m=STEP_M,
            step_yaw_rad=STEP_RAD,
            count=CANDIDATES,
        )
        prior = np.linalg.inv(covariance + np.diag([MIN_STD_M**2, MIN_STD_M**2, MIN_STD_RAD**2]))
        least = MIN_MATCHED_NEIGHBOUR if pair.neighbours else MIN_MATCHED
        found: list[tuple[float, Registration, Floats]] = []
        reason = "no_overlap"
        for start, *_ in starts:
            result = register_submaps(target, source, start)
            if result.matched < least:
                continue
            if result.score < MIN_SCORE or not result.converged:
                reason = "poor_fit"
                continue
            away = result.pose - predicted
            away[2] = math.remainder(away[2], math.tau)
            squared = float(away @ prior @ away)
            if squared > GATE:
                reason = "far_from_prediction"
                continue
            information = usable_information(target, source, result, neighbours=pair.neighbours)
            if not information.any():
                reason = "degenerate"
                continue
            if not any(_alike(result.pose, other.pose) for _, other, _ in found):
                found.append((result.score - PRIOR_WEIGHT * squared, result, information))
        if not found:
            return reason
        found.sort(key=lambda one: -one[0])
        kept = [one for one in found if one[0] >= RIVAL_SHARE * found[0][0]]
        return Loop(
            self.nodes[pair.i],
            self.nodes[pair.j],
            np.stack([result.pose for _, result, _ in kept]),
            np.stack([information for _, _, information in kept]),
            pair.neighbours,
            np.array([result.score for _, result, _ in kept]),
            self.submaps[pair.j].centre_m,
        )


def _alike(a: Floats, b: Floats) -> bool:
    turn = abs(math.remainder(float(a[2] - b[2]), math.tau))
    return math.dist(a[:2], b[:2]) < APART_M and turn < APART_RAD


def usable_information(
    target: Submap, source: Submap, result: Registration, *, neighbours: bool = False
) -> Floats:
    """Return a registration's information without directions that the scene leaves open.

    Along an open direction, such as that of a straight wall, the submaps agree as well half a metre
    further. The agreement tells more than the curvature, which voxels alone give to any direction.

    Args:
        target: as registered.
        source: as registered.
        result: of the registration.
        neighbours: whether they follow each other: they overlap by a part.

    Returns:
        (3, 3) of x, y and yaw, with the standard deviation of every registration added; all zeros
        if no direction is left.
    """
    units = np.diag([1.0, 1.0, 1.0 / LEVER_M])
    _, directions = np.linalg.eigh(units @ result.curvature @ units)
    here = compare_submaps(target, source, result.pose, scale_m=0.2, points=PROBE_POINTS)[1]
    held = np.zeros((3, 3))
    for direction in directions.T:
        step = units @ direction * PROBE_M
        ends = (result.pose + step, result.pose - step)
        there = [
            compare_submaps(target, source, end, scale_m=0.2, points=PROBE_POINTS)[1]
            for end in ends
        ]
        if here - sum(there) / 2 > MIN_SCORE_DROP * here:
            held += np.outer(direction, direction)
    least_m, least_rad, full = MIN_STD_M, MIN_STD_RAD, FULL_SHARE
    if neighbours:
        least_m, least_rad = MIN_STD_NEIGHBOUR_M, MIN_STD_NEIGHBOUR_RAD
        full = NEIGHBOUR_FULL_SHARE
    growth = math.exp(UNMATCHED_GROWTH * max(full - result.matched, 0.0))
    turn = abs(float(result.pose[2]))
    std_m = math.hypot(least_m * growth, TURN_M * turn)
    std_rad = math.hypot(least_rad * growth, TURN_RAD * turn)
    std = np.array([std_m, std_m, std_rad * LEVER_M])
    values, vectors = np.linalg.eigh(held @ (units @ result.information @ units) @ held)
    variances_m2 = np.einsum("ik,i,ik->k", vectors, std**2, vectors)
    known = np.maximum(values, MIN_INFORMATION)
    values = np.where(values > MIN_INFORMATION, 1 / (1 / known + variances_m2), 0.0)
    back = np.linalg.inv(units)
    information: Floats = back @ (vectors * values) @ vectors.T @ back
    return information


def joined_submap(submaps: Sequence[SonarSubmap], poses: Floats) -> Submap | None:
    """Join the submaps of a dive at planar poses (N, 3); None if they hold no echo."""
    occupied: list[Floats] = []
    free: list[Floats] = []
    for submap, pose in zip(submaps, poses, strict=True):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for voxels, points in ((submap.occupied, occupied), (submap.free, free)):
            centres = (voxels + 0.5) * submap.resolution_m
            points.append(centres @ turn.T + [pose[0], pose[1], 0.0])
    if not sum(map(len, occupied)):
        return None
    resolution_m = max(submap.resolution_m for submap in submaps)
    extent_m = np.ptp(np.vstack(occupied + free), axis=0) + MARGIN_M
    while (extent_m / resolution_m).prod() > MAX_VOXELS:  # a large site
        resolution_m *= 1.5
    solid, empty = (_thinned(np.vstack(points), resolution_m) for points in (occupied, free))
    return Submap(solid, empty, resolution_m)


def _thinned(points_m: Floats, cell_m: float) -> Floats:
    """One centre for each voxel that holds a point."""
    voxels = np.unique(np.floor(points_m / cell_m).astype(np.int32), axis=0)
    return np.ascontiguousarray((voxels + 0.5) * cell_m)


def register_dives(target: Submap, source: Submap) -> tuple[Floats | str, float]:
    """Register two whole dives; return target_T_source, or why not, and the score."""
    starts = search_poses(
        target,
        source,
        np.zeros(3),
        half_x_m=FRAME_HALF_M,
        half_y_m=FRAME_HALF_M,
        half_yaw_rad=FRAME_HALF_RAD,
        step_m=FRAME_STEP_M,
        step_yaw_rad=FRAME_STEP_RAD,
        count=FRAME_CANDIDATES,
    )
    found = [register_submaps(target, source, pose) for pose, *_ in starts]
    able = [one for one in found if one.matched >= MIN_FRAME_MATCHED]
    able.sort(key=lambda one: -one.score * one.matched)
    if not able or able[0].score < MIN_FRAME_SCORE:
        return "its map fits that of no other dive", 0.0
    best = able[0]
    for other in able[1:]:
        apart_m = float(np.hypot(*(other.pose - best.pose)[:2]))
        rival = other.score * other.matched > FRAME_RIVAL_SHARE * best.score * best.matched
        if apart_m > 1.0 and rival:
            return "its map fits at two places alike", 0.0
    return best.pose, best.score
