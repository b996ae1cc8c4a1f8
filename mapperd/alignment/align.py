"""Alignment: estimates trajectories again, and judges whether they are better than the odometry."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapperd.alignment.pose_graph import DriftModel, Loop, PoseGraph, PositionFix, Solution, Step
from mapperd.alignment.registration import LoopFinder, Pair, Trial
from mapperd.alignment.submaps import Correction, DiveSubmaps, DiveTrack, compose, inverse

__all__ = ["AlignOptions", "AlignedDive", "Alignment", "align_dive"]

Floats = NDArray[np.float64]

NODE_S = 8.0
"""Nodes are at most so far apart, also where there is no submap."""

ROUNDS = 5
PER_SUBMAP = 3
JUMP_M, JUMP_RAD = 10.0, 1.0
"""Standard deviation of a step over a jump of the odometry."""

STATED_SHARE = 0.05
"""Growth of the odometry's own standard deviation by more than this share of the way loosens a
step: velocity was missing."""

NEIGHBOUR_NOISE = np.array([0.6, 0.6, math.radians(2.0)])
AGAIN_NOISE = np.array([0.3, 0.3, math.radians(2.0)])
"""Standard deviations (m, m, rad) that predictions are widened by: of submaps that follow each other,
where velocity may have failed unnoticed; of registrations that are repeated."""

MIN_LOOPS = 4
MAX_UNCERTAINTY_SHARE = 0.6
MAX_SPLIT_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class AlignOptions:
    """How to align.

    Attributes:
        drift: of the odometry.
        threads: that register submaps.
    """

    drift: DriftModel = DriftModel()
    threads: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """The graph's nodes of one dive.

    Attributes:
        t_ns: (N,) int64.
        odometry: (N, 3) planar poses.
        of_submap: index of the node of each submap.
        steps: odometry from the node before; None at the first.
    """

    t_ns: NDArray[np.int64]
    odometry: Floats
    of_submap: list[int]
    steps: list[Step | None]


def nodes_of(dive: DiveSubmaps) -> Nodes:
    """Place nodes at the submaps, and between them where they are far apart."""
    track = dive.track
    anchors = [submap.anchor_ns for submap in dive.submaps]
    ends = [int(track.t_ns[0]), *anchors, int(track.t_ns[-1])]
    times = set(ends)
    for before, after in zip(ends[:-1], ends[1:], strict=True):
        parts = math.ceil((after - before) / 1e9 / NODE_S / 1.5)
        times |= {before + (after - before) * k // parts for k in range(1, parts)}
    t_ns = np.array(sorted(times), dtype=np.int64)
    odometry = track.at(t_ns)
    steps: list[Step | None] = [None]
    steps += [_step(track, int(t_ns[k - 1]), int(t_ns[k])) for k in range(1, len(t_ns))]
    return Nodes(t_ns, odometry, [int(np.searchsorted(t_ns, t)) for t in anchors], steps)


def _step(track: DiveTrack, begin_ns: int, end_ns: int) -> Step:
    inside = (track.t_ns > begin_ns) & (track.t_ns < end_ns)
    both = track.at(np.array([begin_ns, end_ns], dtype=np.int64))
    way_m = np.vstack([both[:1, :2], track.position_m[inside, :2], both[1:, :2]])
    path_m = float(np.hypot(*np.diff(way_m, axis=0).T).sum())
    ends = np.searchsorted(track.t_ns, [begin_ns, end_ns]).clip(0, len(track.t_ns) - 1)
    before, after = track.deviation_m[ends]
    loose_m = max(0.0, float(after - before) - STATED_SHARE * path_m)
    jumped = track.segment[ends[1]] != track.segment[ends[0]]
    return Step(
        compose(inverse(both[0]), both[1]),
        (end_ns - begin_ns) / 1e9,
        path_m,
        JUMP_M if jumped else loose_m,
        JUMP_RAD if jumped else 0.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class AlignedDive:
    """Result for one dive.

    Attributes:
        t_ns: (N,) of the nodes.
        odometry: (N, 3) planar poses of the nodes by the odometry.
        poses: (N, 3) aligned; those of the odometry if not corrected.
        covariance: (N, 3, 3) of x, y and yaw of the aligned poses.
        drift: (N, 3) estimated scale, crab (rad), turn (rad/s) of the odometry.
        track: the odometry.
        steps: for interpolation.
    """

    t_ns: NDArray[np.int64]
    odometry: Floats
    poses: Floats
    covariance: Floats
    drift: Floats
    track: DiveTrack

    def correction_at(self, t_ns: NDArray[np.int64]) -> Floats:
        """(M, 3) planar transform that takes odometry to aligned poses, between nodes linear."""
        planar = self.track.at(t_ns)
        k = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2)
        span = np.maximum(self.t_ns[k + 1] - self.t_ns[k], 1)
        part = np.clip((t_ns - self.t_ns[k]) / span, 0.0, 1.0)
        ends = [
            compose(self.poses[n], compose(inverse(self.odometry[n]), planar)) for n in (k, k + 1)
        ]
        turn = np.remainder(ends[1][:, 2] - ends[0][:, 2] + math.pi, 2 * math.pi) - math.pi
        placed = ends[0] + part[:, None] * np.column_stack(
            [ends[1][:, :2] - ends[0][:, :2], turn]
        )
        return compose(placed, inverse(planar))

    def poses_at(self, t_ns: NDArray[np.int64]) -> Floats:
        """(M, 3) aligned planar poses."""
        return compose(self.correction_at(t_ns), self.track.at(t_ns))


@dataclass(eq=False)
class Alignment:
    """Result of an alignment.

    Attributes:
        dives: in the given order.
        loops: all registrations, accepted or not.
        corrected: whether the aligned poses are to be used.
        reason: why they are not; empty if they are.
        tried: number of registered pairs.
        rejected: pairs without a registration, by reason.
    """

    dives: list[AlignedDive]
    loops: list[Loop]
    corrected: bool
    reason: str
    tried: int
    rejected: dict[str, int] = field(default_factory=dict)


Read = Callable[[Correction | None], DiveSubmaps]
"""Reads a dive in submaps that follow corrected odometry, or the odometry itself."""


def align_dive(
    read: Read,
    options: AlignOptions = AlignOptions(),
    progress: Callable[[float, str], None] = lambda *_: None,
) -> Alignment:
    """Align one dive.

    The odometry also drifts within a submap, which shears it. So all is done twice: the second time
    with submaps that follow the trajectory of the first.
    """
    dive = read(None)
    nodes = nodes_of(dive)
    graph = PoseGraph(nodes.odometry, nodes.steps, options.drift)
    graph.solve()
    graph.prepare_covariances()
    finder = LoopFinder(dive.submaps, nodes.of_submap, options.threads)
    graph.loops += finder.register(_predicted(finder.neighbours(), nodes, graph, NEIGHBOUR_NOISE))
    solution, known = _close_loops(graph, finder, [])
    first = _aligned(dive, nodes, graph, solution)
    dive = read(first.correction_at)
    again = LoopFinder(dive.submaps, nodes.of_submap, options.threads)
    pairs = [
        pair
        for pair in [*finder.neighbours(), *known]
        if any(
            loop.accepted and (loop.i, loop.j) == (nodes.of_submap[pair.i], nodes.of_submap[pair.j])
            for loop in graph.loops
        )
    ]
    trials = _predicted(pairs, nodes, graph, AGAIN_NOISE)
    graph.loops = again.register(trials)
    solution = graph.solve()
    solution, _ = _close_loops(graph, again, pairs)
    aligned = _aligned(dive, nodes, graph, solution)
    return Alignment(
        [aligned], graph.loops, True, "", finder.tried + again.tried, finder.rejected
    )


def _close_loops(
    graph: PoseGraph, finder: LoopFinder, known: list[Pair]
) -> tuple[Solution, list[Pair]]:
    """Register revisits, the best predicted first, until there are no more."""
    solution = graph.solve()
    known = list(known)
    for _ in range(ROUNDS):
        graph.prepare_covariances()
        trials = finder.loops(graph, known, PER_SUBMAP)
        if not trials:
            break
        known += [trial.pair for trial in trials]
        graph.loops += finder.register(trials)
        solution = graph.solve()
    return solution, known


def _predicted(
    pairs: Sequence[Pair], nodes: Nodes, graph: PoseGraph, noise: Floats
) -> list[Trial]:
    trials = []
    for pair in pairs:
        i, j = nodes.of_submap[pair.i], nodes.of_submap[pair.j]
        predicted = compose(inverse(graph.poses[i]), graph.poses[j])
        covariance = graph.covariance_of(i, [j])[0] + np.diag(noise**2)
        trials.append(Trial(pair, predicted, covariance))
    return trials


def _aligned(
    dive: DiveSubmaps, nodes: Nodes, graph: PoseGraph, solution: Solution
) -> AlignedDive:
    covariance = graph.prepare_covariances()
    return AlignedDive(
        nodes.t_ns, nodes.odometry, solution.poses, covariance, solution.drift, dive.track
    )
