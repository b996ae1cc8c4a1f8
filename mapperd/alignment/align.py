"""Alignment: estimates trajectories again, and judges whether they are better than the odometry."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapperd._core import Submap, register_submaps, search_poses
from mapperd.alignment.pose_graph import (
    DriftModel,
    Loop,
    OdometryStep,
    PoseAnchor,
    PoseGraph,
    PositionFix,
    Solution,
)
from mapperd.alignment.registration import LoopFinder, Pair, Trial
from mapperd.alignment.submaps import (
    Correction,
    DiveSubmaps,
    OdometryTrack,
    SonarSubmap,
    compose,
    inverse,
)
from mapperd.errors import ReplayError

__all__ = [
    "AlignOptions",
    "AlignedDive",
    "Alignment",
    "DiveInput",
    "Fix",
    "Read",
    "align",
    "odometry_step",
]

Floats = NDArray[np.float64]

Read = Callable[[Correction | None], DiveSubmaps]
"""Reads a dive in submaps that follow corrected odometry, or the odometry itself."""

Fix = tuple[int, float, float, float]
"""A known position: Unix time (ns), x and y (m) in the common frame, standard deviation (m)."""

Progress = Callable[[float, str], None]

NODE_S = 12.0
"""Nodes are at most so far apart, also where there is no submap."""

ROUNDS, ROUNDS_BETWEEN = 5, 2
PER_SUBMAP = 3
JUMP_M, JUMP_RAD = 10.0, 1.0
"""Standard deviation of a step over a jump of the odometry."""

STATED_SHARE = 0.05
"""Growth of the odometry's own standard deviation by more than this share of the way loosens a
step: velocity was missing."""

NEIGHBOUR_NOISE = np.array([0.6, 0.6, math.radians(2.0)])
AGAIN_NOISE = np.array([0.3, 0.3, math.radians(2.0)])
"""Standard deviations (m, m, rad) that predictions are widened by: of submaps that follow each
other, where velocity may have failed unnoticed; of registrations that are repeated."""

FRAME_STEPS, FRAME_SPREAD = 10, 3.0
"""Steps of the robust fit of a frame to fixes; the distance between them, in standard deviations,
that gives a heading."""

FREE_FRAME = np.array([1e3, 1e3, 10.0])
FOUND_FRAME = np.array([0.5, 0.5, math.radians(2.0)])
"""Standard deviations (m, m, rad) of a dive's first pose: held by position fixes alone; by the
registration of whole dives."""

FRAME_HALF_M, FRAME_HALF_RAD = 12.0, math.radians(45.0)
FRAME_STEP_M, FRAME_STEP_RAD = 0.5, math.radians(3.0)
FRAME_CANDIDATES = 8
MIN_FRAME_SCORE, MIN_FRAME_MATCHED, FRAME_RIVAL_SHARE = 0.6, 0.3, 0.9
"""What the registration of two whole dives must reach, and the share of its score that any other
place must stay below."""

MIN_LOOPS = 6
MIN_BETWEEN_DIVES = 4
MIN_ACCEPTED_SHARE = 0.6
MAX_UNCERTAINTY_SHARE = 0.45
MIN_CORRECTION_DEVIATIONS = 1.5
MAX_SPLIT_M, MAX_SPLIT_SHARE = 0.25, 0.5
"""What an alignment must reach to be used: revisits and their accepted share; standard deviation as
a share of the odometry's; correction in standard deviations; difference of the trajectories by two
halves of the revisits, absolute or as a share of the correction."""


@dataclass(frozen=True, slots=True)
class AlignOptions:
    """How to align.

    Attributes:
        drift: of the odometry.
        threads: that register submaps.
    """

    drift: DriftModel = field(default_factory=DriftModel)
    threads: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class DiveInput:
    """A dive to align.

    Attributes:
        name: for files and messages.
        read: reads it.
        frame: (3,) known planar pose of its odometry's frame in the common frame; None leaves it to
            the alignment. The first dive's is the common frame without one.
        fixes: known positions in the common frame.
    """

    name: str
    read: Read
    frame: Floats | None = None
    fixes: tuple[Fix, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class AlignedDive:
    """Result for one dive. Planar poses are x, y (m) and yaw (rad) of the base.

    Attributes:
        name: of the input.
        t_ns: (N,) int64, of the nodes.
        odometry: (N, 3) poses of the nodes in the odometry's frame.
        poses: (N, 3) in the common frame; if not corrected, those of the odometry in that frame.
        covariance: (N, 3, 3) of the aligned poses; of the odometry's if not corrected.
        drift: (N, 3) estimated scale, crab (rad), turn (rad/s) of the odometry.
        frame: (3,) pose of the odometry's frame in the common frame, at the first node.
        track: the odometry.
    """

    name: str
    t_ns: NDArray[np.int64]
    odometry: Floats
    poses: Floats
    covariance: Floats
    drift: Floats
    frame: Floats
    track: OdometryTrack

    def correction_at(self, t_ns: NDArray[np.int64]) -> Floats:
        """(M, 3) transforms that take the odometry to aligned poses, mixed between nodes."""
        planar = self.track.at(t_ns)
        return compose(self.poses_at(t_ns), inverse(planar))

    def poses_at(self, t_ns: NDArray[np.int64]) -> Floats:
        """(M, 3) aligned poses."""
        planar = self.track.at(t_ns)
        k = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2)
        span = np.maximum(self.t_ns[k + 1] - self.t_ns[k], 1)
        part = np.clip((t_ns - self.t_ns[k]) / span, 0.0, 1.0)
        before, after = (
            compose(self.poses[n], compose(inverse(self.odometry[n]), planar)) for n in (k, k + 1)
        )
        turn = np.remainder(after[:, 2] - before[:, 2] + math.pi, 2 * math.pi) - math.pi
        step = np.column_stack([after[:, :2] - before[:, :2], turn])
        return np.asarray(before + part[:, None] * step)


@dataclass(eq=False)
class Alignment:
    """Result of an alignment.

    Attributes:
        dives: in the given order.
        loops: all registrations, accepted or not; nodes count over all dives.
        corrected: whether the aligned poses are to be used.
        reason: why they are not; empty if they are.
        tried: number of registered pairs.
        rejected: pairs without a registration, by reason.
        figures: what the verdict rests on, by name.
    """

    dives: list[AlignedDive]
    loops: list[Loop]
    corrected: bool
    reason: str
    tried: int
    rejected: dict[str, int] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """One line."""
        return "corrected" if self.corrected else f"not corrected, because {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class _DiveNodes:
    """A dive and its nodes: times, planar odometry, of each submap, and steps from node to node."""

    given: DiveInput
    submaps: list[SonarSubmap]
    fragments: list[SonarSubmap]
    track: OdometryTrack
    t_ns: NDArray[np.int64]
    odometry: Floats
    of_submap: list[int]
    of_fragment: list[int]
    steps: list[OdometryStep | None]

    @classmethod
    def of(cls, given: DiveInput, dive: DiveSubmaps) -> "_DiveNodes":
        """Place nodes at the submaps, between them where they are far apart, and at fixes."""
        track = dive.track
        anchors = [submap.anchor_ns for submap in dive.submaps]
        parts = [fragment.anchor_ns for fragment in dive.fragments]
        begin, end = int(track.t_ns[0]), int(track.t_ns[-1])
        ends = sorted(
            {begin, *anchors, *parts, end, *(t for t, *_ in given.fixes if begin <= t <= end)}
        )
        times = set(ends)
        for before, after in itertools.pairwise(ends):
            count = math.ceil((after - before) / 1e9 / NODE_S)
            times |= {before + (after - before) * k // count for k in range(1, count)}
        t_ns = np.array(sorted(times), dtype=np.int64)
        steps: list[OdometryStep | None] = [None]
        steps += [odometry_step(track, int(t_ns[k - 1]), int(t_ns[k])) for k in range(1, len(t_ns))]
        of_submap, of_fragment = (np.searchsorted(t_ns, at).tolist() for at in (anchors, parts))
        odometry = track.at(t_ns)
        return cls(
            given,
            dive.submaps,
            dive.fragments,
            track,
            t_ns,
            odometry,
            of_submap,
            of_fragment,
            steps,
        )

    def frame_by_fixes(self) -> Floats:
        """(3,) pose of the odometry's frame that fits the fixes best; zero without fixes.

        Its heading is fitted where the fixes are further apart than they are uncertain.
        """
        fixes = self.fixes(0)
        if not fixes:
            return np.zeros(3)
        here_m = self.odometry[[fix.node for fix in fixes], :2] @ np.array([1, 1j])
        there_m = np.array([fix.position_m for fix in fixes]) @ np.array([1, 1j])
        deviation_m = np.array([fix.deviation_m for fix in fixes])
        weights = deviation_m**-2.0
        turn = complex(1.0)
        for _ in range(FRAME_STEPS):
            here, there = (np.average(points, weights=weights) for points in (here_m, there_m))
            spread_m = math.sqrt(np.average(abs(here_m - here) ** 2, weights=weights))
            if spread_m > FRAME_SPREAD * deviation_m.mean():
                product = complex(np.sum(weights * np.conj(here_m - here) * (there_m - there)))
                turn = product / max(abs(product), 1e-12)
            away_m = abs(there_m - there - turn * (here_m - here))
            scale_m = max(1.5 * float(np.median(away_m)), float(deviation_m.mean()))
            weights = deviation_m**-2.0 / (1 + (away_m / scale_m) ** 2) ** 2
        shift = there - turn * here
        return np.array([shift.real, shift.imag, math.atan2(turn.imag, turn.real)])

    def fixes(self, first: int) -> list[PositionFix]:
        """Known positions, at nodes counted from `first`."""
        inside = [fix for fix in self.given.fixes if self.t_ns[0] <= fix[0] <= self.t_ns[-1]]
        return [
            PositionFix(first + int(np.searchsorted(self.t_ns, t)), np.array([x, y]), deviation_m)
            for t, x, y, deviation_m in inside
        ]


def odometry_step(track: OdometryTrack, begin_ns: int, end_ns: int) -> OdometryStep:
    """Return the odometry between two times, and how far it can be trusted."""
    inside = (track.t_ns > begin_ns) & (track.t_ns < end_ns)
    both = track.at(np.array([begin_ns, end_ns], dtype=np.int64))
    way_m = np.vstack([both[:1, :2], track.position_m[inside, :2], both[1:, :2]])
    path_m = float(np.hypot(*np.diff(way_m, axis=0).T).sum())
    ends = np.searchsorted(track.t_ns, [begin_ns, end_ns]).clip(0, len(track.t_ns) - 1)
    before, after = track.deviation_m[ends]
    loose_m = max(0.0, float(after - before) - STATED_SHARE * path_m)
    jumped = track.segment[ends[1]] != track.segment[ends[0]]
    return OdometryStep(
        compose(inverse(both[0]), both[1]),
        (end_ns - begin_ns) / 1e9,
        path_m,
        JUMP_M if jumped else loose_m,
        JUMP_RAD if jumped else 0.0,
    )


def align(
    dives: Sequence[DiveInput],
    options: AlignOptions | None = None,
    progress: Progress = lambda *_: None,
) -> Alignment:
    """Align one or more dives; the same input gives the same result, whatever the threads.

    Each dive is aligned on its own. Dives whose frames are unknown are then registered to those
    before them as a whole, and revisits between all dives join one graph.

    Args:
        dives: at least one.
        options: drift of the odometry, and threads.
        progress: called with the share that is done, and what is being done.

    Raises:
        ReplayError: no poses of a dive are known, or names of dives are equal.
        RecordingError: a recording cannot be read.
    """
    options = options or AlignOptions()
    names = [dive.name for dive in dives]
    if len(set(names)) < len(names):
        raise ReplayError("two dives have the same name")
    alone = []
    for k, dive in enumerate(dives):

        def part(share: float, what: str, k: int = k, name: str = dive.name) -> None:
            progress((k + share) / len(dives), f"{name}: {what}")

        alone.append(_AloneDive.align(dive, options, part))
    if len(dives) == 1:
        return alone[0].result()
    return _aligned_together(alone, options)


@dataclass(eq=False)
class _AloneDive:
    """A dive that was aligned by itself."""

    dive: _DiveNodes
    graph: PoseGraph
    finder: LoopFinder
    solution: Solution
    prior_m: float
    tried: int

    @classmethod
    def align(cls, given: DiveInput, options: AlignOptions, progress: Progress) -> "_AloneDive":
        """Align in two passes: the second has submaps that follow the trajectory of the first.

        The odometry also drifts within a submap, which shears it.
        """
        progress(0.0, "mapping")
        dive = _DiveNodes.of(given, given.read(None))
        start = dive.odometry
        frame = given.frame if given.frame is not None else dive.frame_by_fixes()
        graph = PoseGraph(compose(frame[None], start), dive.steps, options.drift)
        graph.fixes = dive.fixes(0)
        if graph.fixes and given.frame is None:
            graph.anchors = [PoseAnchor(0, graph.start[0], FREE_FRAME)]
        graph.solve()
        prior_m = _deviation_m(graph.prepare_covariances())
        first = LoopFinder(dive.submaps, dive.of_submap, options.threads)
        motion = LoopFinder(dive.fragments, dive.of_fragment, options.threads)
        progress(0.3, "registering")
        trials = _predicted(motion.neighbours(), dive.of_fragment, graph, NEIGHBOUR_NOISE)
        graph.loops += motion.register(trials)
        solution, known = _close_loops(graph, first, [])
        progress(0.5, "mapping again")
        aligned = _result_of(dive, solution.poses, graph.prepare_covariances(), solution.drift)
        again = given.read(aligned.correction_at)
        finder = LoopFinder(again.submaps, dive.of_submap, options.threads)
        motion = LoopFinder(again.fragments, dive.of_fragment, options.threads)
        dive = replace(dive, submaps=again.submaps, fragments=again.fragments)
        revisits = {(loop.i, loop.j) for loop in graph.loops if loop.accepted}
        pairs = [p for p in known if (dive.of_submap[p.i], dive.of_submap[p.j]) in revisits]
        progress(0.8, "registering again")
        trials = _predicted(motion.neighbours(), dive.of_fragment, graph, AGAIN_NOISE)
        again_trials = _predicted(pairs, dive.of_submap, graph, AGAIN_NOISE)
        graph.loops = motion.register(trials) + finder.register(again_trials)
        solution, _ = _close_loops(graph, finder, pairs)
        return cls(dive, graph, finder, solution, prior_m, first.tried + finder.tried)

    def result(self) -> Alignment:
        """Judge the alignment of this dive alone."""
        covariance = self.graph.prepare_covariances()
        figures, reason = _judged(self.graph, _deviation_m(covariance), self.prior_m)
        if reason:
            self.solution = _without_loops(self.graph)
            covariance = self.graph.prepare_covariances()
        aligned = _result_of(self.dive, self.solution.poses, covariance, self.solution.drift)
        if reason:
            aligned = _uncorrected(aligned)
        rejected = dict(sorted(self.finder.rejected.items()))
        return Alignment(
            [aligned], self.graph.loops, not reason, reason, self.tried, rejected, figures
        )


def _uncorrected(dive: AlignedDive) -> AlignedDive:
    return replace(dive, poses=compose(dive.frame[None], dive.odometry))


def _result_of(dive: _DiveNodes, poses: Floats, covariance: Floats, drift: Floats) -> AlignedDive:
    frame = compose(poses[0], inverse(dive.odometry[0]))
    return AlignedDive(
        dive.given.name, dive.t_ns, dive.odometry, poses, covariance, drift, frame, dive.track
    )


def _without_loops(graph: PoseGraph) -> Solution:
    """Solve again without revisits; the graph keeps them, refused."""
    loops, graph.loops = graph.loops, []
    graph.reset()
    solution = graph.solve()
    graph.prepare_covariances()
    for loop in loops:
        loop.weight = 0.0
    graph.loops = loops
    return solution


def _close_loops(
    graph: PoseGraph, finder: LoopFinder, known: Sequence[Pair], rounds: int = ROUNDS
) -> tuple[Solution, list[Pair]]:
    """Register revisits, the best predicted first, until there are no more."""
    solution, tried = graph.solve(), list(known)
    for _ in range(rounds):
        graph.prepare_covariances()
        trials = finder.loops(graph, tried, PER_SUBMAP)
        if not trials:
            break
        tried += [trial.pair for trial in trials]
        graph.loops += finder.register(trials)
        solution = graph.solve()
    return solution, tried


def _predicted(
    pairs: Sequence[Pair], nodes: Sequence[int], graph: PoseGraph, noise: Floats
) -> list[Trial]:
    trials = []
    graph.prepare_covariances()
    for pair in pairs:
        i, j = nodes[pair.i], nodes[pair.j]
        predicted = compose(inverse(graph.poses[i]), graph.poses[j])
        covariance = graph.covariance_of(i, [j])[0] + np.diag(noise**2)
        trials.append(Trial(pair, predicted, covariance))
    return trials


def _deviation_m(covariance: Floats) -> float:
    """Mean horizontal standard deviation of the nodes."""
    return float(np.sqrt(np.maximum(covariance[:, 0, 0] + covariance[:, 1, 1], 0)).mean())


def _judged(graph: PoseGraph, deviation_m: float, prior_m: float) -> tuple[dict[str, float], str]:
    """Return what the verdict rests on, and why the result must not be used; empty if it may.

    Fixes correct a dive without revisits, too; but revisits must not contradict them.
    """
    loops = [loop for loop in graph.loops if not loop.neighbours]
    accepted = [loop for loop in loops if loop.accepted]
    correction_m = _rms_m(graph.start, graph.poses)
    split_m = _split_m(graph, accepted)
    figures = {
        "revisits_found": float(len(loops)),
        "revisits_accepted": float(len(accepted)),
        "odometry_deviation_m": prior_m,
        "deviation_m": deviation_m,
        "correction_m": correction_m,
        "split_m": split_m,
    }
    if len(accepted) < MIN_LOOPS and not graph.fixes:
        found = f"{len(accepted)} revisits" if accepted else "no revisit"
        return figures, f"{found} could be registered, and {MIN_LOOPS} are needed"
    if len(accepted) < MIN_ACCEPTED_SHARE * len(loops):
        return figures, f"{len(loops) - len(accepted)} of {len(loops)} revisits contradict the rest"
    if deviation_m > MAX_UNCERTAINTY_SHARE * prior_m and not graph.fixes:
        share = deviation_m / max(prior_m, 1e-9)
        return figures, f"the revisits leave {share:.0%} of the uncertainty of the odometry"
    if correction_m < MIN_CORRECTION_DEVIATIONS * deviation_m:
        return figures, (
            f"the correction is {correction_m:.2f} m, and its standard deviation "
            f"{deviation_m:.2f} m"
        )
    if split_m > max(MAX_SPLIT_M, MAX_SPLIT_SHARE * correction_m):
        return figures, (
            f"two halves of the revisits give trajectories {split_m:.2f} m apart, and the "
            f"correction is {correction_m:.2f} m"
        )
    return figures, ""


def _rms_m(a: Floats, b: Floats) -> float:
    return float(np.sqrt(((a[:, :2] - b[:, :2]) ** 2).sum(axis=1).mean()))


def _split_m(graph: PoseGraph, accepted: Sequence[Loop]) -> float:
    """RMS distance of the trajectories by two halves of the revisits."""
    saved, states = list(graph.loops), graph.save()
    weights = [(loop, loop.weight, loop.chosen) for loop in saved]
    halves = []
    for half in (0, 1):
        left = {id(loop) for loop in accepted[half::2]}
        graph.loops = [loop for loop in saved if loop.neighbours or id(loop) in left]
        halves.append(graph.solve().poses)
    graph.loops = saved
    graph.restore(states)
    for loop, weight, chosen in weights:
        loop.weight, loop.chosen = weight, chosen
    return _rms_m(*halves)


def _aligned_together(alone: list[_AloneDive], options: AlignOptions) -> Alignment:
    """Join dives that were aligned by themselves in one graph."""
    results = [one.result() for one in alone]
    first = np.cumsum([0, *(len(one.dive.t_ns) for one in alone)])
    frames, reason = _frames_of(alone)
    tried = sum(one.tried for one in alone)
    rejected: dict[str, int] = {}
    if reason:
        dives = [_uncorrected(result.dives[0]) for result in results]
        return Alignment(
            dives, _shifted_loops(alone, first), corrected=False, reason=reason, tried=tried
        )
    start = np.vstack(
        [compose(frame[None], one.graph.start) for frame, one in zip(frames, alone, strict=True)]
    )
    graph = PoseGraph(start, [step for one in alone for step in one.dive.steps], options.drift)
    graph.anchors = _anchors_of(alone, frames, first)
    graph.fixes = [fix for k, one in enumerate(alone) for fix in one.dive.fixes(int(first[k]))]
    graph.loops = _shifted_loops(alone, first)
    poses = [compose(f[None], one.solution.poses) for f, one in zip(frames, alone, strict=True)]
    graph.begin_at(np.vstack(poses), np.vstack([one.solution.drift for one in alone]))
    submaps = [submap for one in alone for submap in one.dive.submaps]
    nodes = [int(first[k]) + n for k, one in enumerate(alone) for n in one.dive.of_submap]
    dive_of = [k for k, one in enumerate(alone) for _ in one.dive.submaps]
    finder = LoopFinder(submaps, nodes, options.threads, dive_of=dive_of)
    solution = graph.solve()
    solution, _ = _close_loops(graph, finder, (), ROUNDS_BETWEEN)
    covariance = graph.prepare_covariances()
    rejected = dict(sorted(finder.rejected.items()))
    dive_of_node = np.repeat(np.arange(len(alone)), np.diff(first))
    between = [loop for loop in graph.loops if dive_of_node[loop.i] != dive_of_node[loop.j]]
    reason = _judged_together(alone, graph.loops, dive_of_node)
    figures = {
        "revisits_between_dives": float(len(between)),
        "revisits_between_dives_accepted": float(sum(loop.accepted for loop in between)),
        "deviation_m": _deviation_m(covariance),
    }
    dives = []
    for k, one in enumerate(alone):
        part = slice(int(first[k]), int(first[k + 1]))
        aligned = _result_of(one.dive, solution.poses[part], covariance[part], solution.drift[part])
        dives.append(_uncorrected(aligned) if reason else aligned)
    tried += finder.tried
    return Alignment(dives, graph.loops, not reason, reason, tried, rejected, figures)


def _shifted_loops(alone: list[_AloneDive], first: NDArray[np.int64]) -> list[Loop]:
    """The loops of all dives, with nodes that count over all dives."""
    return [
        replace(loop, i=loop.i + int(first[k]), j=loop.j + int(first[k]))
        for k, one in enumerate(alone)
        for loop in one.graph.loops
    ]


def _anchors_of(
    alone: list[_AloneDive], frames: list[Floats], first: NDArray[np.int64]
) -> list[PoseAnchor]:
    """First poses: exact of the first dive and where a frame is given, else as they were found."""
    anchors = []
    for k, one in enumerate(alone):
        [own] = one.graph.anchors
        given = one.dive.given.frame is not None
        deviation = own.deviation if k == 0 or given else FOUND_FRAME
        anchors.append(PoseAnchor(int(first[k]), compose(frames[k], own.pose), deviation))
    return anchors


def _judged_together(
    alone: list[_AloneDive], loops: Sequence[Loop], dive_of_node: NDArray[np.intp]
) -> str:
    """Return why the result of several dives must not be used; empty if it may."""
    revisits = [loop for loop in loops if not loop.neighbours]
    for k, one in enumerate(alone):
        name = one.dive.given.name
        own = [loop for loop in revisits if k in (dive_of_node[loop.i], dive_of_node[loop.j])]
        accepted = sum(loop.accepted for loop in own)
        if accepted < MIN_LOOPS and not one.graph.fixes:
            return f"{name}: {accepted} revisits could be registered, and {MIN_LOOPS} are needed"
        if accepted < MIN_ACCEPTED_SHARE * len(own):
            contrary = len(own) - accepted
            return f"{name}: {contrary} of {len(own)} revisits contradict the rest"
        if k == 0 or one.dive.given.frame is not None or one.graph.fixes:
            continue
        accepted = sum(
            loop.accepted and dive_of_node[loop.i] != dive_of_node[loop.j] for loop in own
        )
        if accepted < MIN_BETWEEN_DIVES:
            return (
                f"{name}: {accepted} of its submaps could be registered to other dives, and "
                f"{MIN_BETWEEN_DIVES} are needed"
            )
    return ""


def _frames_of(alone: list[_AloneDive]) -> tuple[list[Floats], str]:
    """Find how each dive must be moved into the common frame, or why one cannot be placed."""
    frames: list[Floats] = []
    placed: list[Submap] = []
    for k, one in enumerate(alone):
        whole = _whole_map(one, np.zeros(3))
        if k == 0 or one.dive.given.frame is not None or one.graph.fixes:
            frames.append(np.zeros(3))
        elif whole is None or not placed:
            return [], f"{one.dive.given.name}: too few echoes to register it to other dives"
        else:
            found = [_placed(target, whole) for target in placed]
            best = max(found, key=lambda one: one[1])
            if isinstance(best[0], str):
                return [], f"{one.dive.given.name}: {best[0]}"
            frames.append(best[0])
        if whole is not None:
            at = frames[k]
            placed.append(whole if not at.any() else _whole_map(one, at) or whole)
    return frames, ""


def _whole_map(one: _AloneDive, frame: Floats) -> Submap | None:
    """The map of a whole dive at its aligned poses, moved by a planar transform."""
    occupied: list[Floats] = []
    free: list[Floats] = []
    for submap, node in zip(one.dive.submaps, one.dive.of_submap, strict=True):
        pose = compose(frame, one.solution.poses[node])
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for voxels, points in ((submap.occupied, occupied), (submap.free, free)):
            centres = (voxels + 0.5) * submap.resolution_m
            points.append(centres @ turn.T + [pose[0], pose[1], 0.0])
    if not sum(map(len, occupied)):
        return None
    resolution_m = one.dive.submaps[0].resolution_m
    solid, empty = (_thinned(np.vstack(points), resolution_m) for points in (occupied, free))
    return Submap(solid, empty, resolution_m)


def _thinned(points_m: Floats, cell_m: float) -> Floats:
    """One centre for each voxel that holds a point."""
    voxels = np.unique(np.floor(points_m / cell_m).astype(np.int32), axis=0)
    return np.ascontiguousarray((voxels + 0.5) * cell_m)


def _placed(target: Submap, source: Submap) -> tuple[Floats | str, float]:
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
