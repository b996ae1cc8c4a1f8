"""Alignment: estimates trajectories again, and judges whether they are better than the odometry."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapperd._core import Submap
from mapperd.alignment.pose_graph import (
    DriftModel,
    Loop,
    OdometryStep,
    PoseAnchor,
    PoseGraph,
    PositionFix,
    Solution,
)
from mapperd.alignment.registration import (
    LoopFinder,
    Pair,
    Trial,
    joined_submap,
    register_dives,
)
from mapperd.alignment.submaps import (
    MIN_OUTAGE_SHARE,
    Correction,
    DiveSubmaps,
    OdometryTrack,
    SonarSubmap,
    compose,
    inverse,
    is_outage,
)
from mapperd.errors import ReplayError

__all__ = [
    "AlignOptions",
    "AlignedDive",
    "Alignment",
    "DiveInput",
    "Fix",
    "SubmapReader",
    "align",
    "odometry_steps",
]

Floats = NDArray[np.float64]

SubmapReader = Callable[[Correction | None], DiveSubmaps]
"""Reads a dive in submaps that follow corrected odometry, or the odometry itself."""

Fix = tuple[int, float, float, float]
"""A known position: Unix time (ns), x and y (m) in the common frame, standard deviation (m)."""

Progress = Callable[[float, str], None]

NODE_S = 12.0
"""Nodes are at most so far apart, also where there is no submap."""

MAX_ROUNDS, MAX_ROUNDS_BETWEEN_DIVES = 5, 2
MAX_PARTNERS = 3
JUMP_M, JUMP_RAD = 10.0, 1.0
"""Standard deviation of a step over a jump of the odometry."""

OUTAGE_S, GROWTH_WINDOW_S = 30.0, 2.0
"""Time over which the error of a missing velocity stays alike; over which the growth of the stated
standard deviation is measured."""

NEIGHBOUR_NOISE = np.array([0.6, 0.6, math.radians(2.0)])
SECOND_PASS_NOISE = np.array([0.3, 0.3, math.radians(2.0)])
"""Standard deviations (m, m, rad) that predictions are widened by: of submaps that follow each
other, where velocity may have failed unnoticed; of registrations that are repeated."""

FIX_INTERVAL_NS = 2_000_000_000
"""Fixes of one interval of this length are merged: their errors are correlated."""

MAX_DRIFT, MAX_DRIFT_OFFSET_M, MIN_AGREEING = 0.2, 3.0, 0.5
"""What odometry may err by, as a share of the distance travelled and in all; the share of the fixes
that one must agree with."""

FRAME_STEPS, FRAME_SPREAD = 10, 3.0
"""Steps of the robust fit of a frame to fixes; the distance between them, in standard deviations,
that gives a heading."""

FREE_POSE_STD = np.array([1e3, 1e3, 10.0])
FREE_POSITION_STD = np.array([1e3, 1e3, 1e-6])
REGISTERED_FRAME_STD = np.array([0.5, 0.5, math.radians(2.0)])
"""Standard deviations (m, m, rad) of a dive's first pose: held by position fixes alone, with a
heading or without; by the registration of whole dives."""

MIN_FIXES = 3
"""Accepted fixes that correct a dive without revisits."""

MIN_LOOPS = 6
MIN_BETWEEN_DIVES = 4
MIN_ACCEPTED_SHARE = 0.7
MAX_UNCERTAINTY_SHARE = 0.35
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
    read: SubmapReader
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
        tried: number of comparisons of submaps for revisits, in both passes.
        rejected: those without a registration, by reason.
        figures: what the verdict rests on, by name.
    """

    dives: list[AlignedDive]
    loops: list[Loop]
    corrected: bool
    reason: str
    tried: int
    rejected: Counter[str] = field(default_factory=Counter)
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
    unreachable: int

    @classmethod
    def of(cls, given: DiveInput, dive: DiveSubmaps) -> "_DiveNodes":
        """Place nodes at the submaps, between them where they are far apart, and at fixes."""
        track = dive.track
        merged = _merged_fixes(given, track)
        fixes = _consistent_fixes(merged, track)
        given = replace(given, fixes=fixes)
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
        steps = odometry_steps(track, t_ns)
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
            len(merged) - len(fixes),
        )

    def frame_by_fixes(self) -> tuple[Floats, bool]:
        """Pose (3,) of the odometry's frame that fits the fixes best, and whether heading is known.

        Its heading is fitted where the fixes are further apart than they are uncertain. Zero
        without fixes.
        """
        fixes = self.fixes(0)
        if not fixes:
            return np.zeros(3), False
        here_m = self.odometry[[fix.node for fix in fixes], :2] @ np.array([1, 1j])
        there_m = np.array([fix.position_m for fix in fixes]) @ np.array([1, 1j])
        deviation_m = np.array([fix.deviation_m for fix in fixes])
        weights = deviation_m**-2.0
        turn, is_known = complex(1.0), False
        for _ in range(FRAME_STEPS):
            here, there = (np.average(points, weights=weights) for points in (here_m, there_m))
            spread_m = math.sqrt(np.average(abs(here_m - here) ** 2, weights=weights))
            is_known = bool(spread_m > FRAME_SPREAD * deviation_m.mean())
            if is_known:
                product = complex(np.sum(weights * np.conj(here_m - here) * (there_m - there)))
                turn = product / max(abs(product), 1e-12)
            away_m = abs(there_m - there - turn * (here_m - here))
            scale_m = max(1.5 * float(np.median(away_m)), float(deviation_m.mean()))
            weights = deviation_m**-2.0 / (1 + (away_m / scale_m) ** 2) ** 2
        shift = there - turn * here
        return np.array([shift.real, shift.imag, math.atan2(turn.imag, turn.real)]), is_known

    def fixes(self, first: int) -> list[PositionFix]:
        """Known positions, at nodes counted from `first`."""
        return [
            PositionFix(first + int(np.searchsorted(self.t_ns, t)), np.array([x, y]), deviation_m)
            for t, x, y, deviation_m in self.given.fixes
        ]

    @property
    def own_frame(self) -> Floats:
        """(3,) frame of its odometry where nothing else is known."""
        return np.zeros(3) if self.given.frame is None else self.given.frame


def _consistent_fixes(fixes: tuple[Fix, ...], track: OdometryTrack) -> tuple[Fix, ...]:
    """Leave out fixes whose distances from most others contradict the odometry."""
    if not fixes:
        return fixes
    t_ns = np.array([t for t, *_ in fixes], dtype=np.int64)
    there_m = np.array([(x, y) for _, x, y, _ in fixes])
    deviation_m = np.array([deviation_m for *_, deviation_m in fixes])
    here_m = track.at(t_ns)[:, :2]
    path_m = np.cumsum(np.hypot(*np.diff(track.position_m[:, :2], axis=0, prepend=0.0).T))
    path_m = np.interp(t_ns, track.t_ns, path_m)

    def between(points_m: Floats) -> Floats:
        return np.asarray(np.hypot(*np.moveaxis(points_m[:, None] - points_m, 2, 0)))

    allowed_m = MAX_DRIFT * abs(path_m[:, None] - path_m) + MAX_DRIFT_OFFSET_M
    allowed_m += 3 * (deviation_m[:, None] + deviation_m)
    agree = abs(between(there_m) - between(here_m)) <= allowed_m
    return tuple(
        fix for fix, others in zip(fixes, agree, strict=True) if others.mean() >= MIN_AGREEING
    )


def _merged_fixes(given: DiveInput, track: OdometryTrack) -> tuple[Fix, ...]:
    """Return the fixes during a dive, close ones united.

    Raises:
        ReplayError: there are fixes, and none during the dive.
    """
    begin_ns, end_ns = int(track.t_ns[0]), int(track.t_ns[-1])
    inside = sorted(fix for fix in given.fixes if begin_ns <= fix[0] <= end_ns)
    if given.fixes and not inside:
        raise ReplayError(
            f"{given.name}: none of {len(given.fixes)} position fixes is within the dive, from "
            f"{begin_ns / 1e9:.3f} to {end_ns / 1e9:.3f} s; check the clock of the fixes"
        )
    united = []
    for _, group in itertools.groupby(inside, key=lambda fix: fix[0] // FIX_INTERVAL_NS):
        rows = list(group)
        weights = np.array([deviation_m**-2.0 for *_, deviation_m in rows])
        since_ns, x, y = np.average(
            [(t - begin_ns, x, y) for t, x, y, _ in rows], axis=0, weights=weights
        )
        best_m = min(deviation_m for *_, deviation_m in rows)
        united.append((begin_ns + round(since_ns), float(x), float(y), best_m))
    return tuple(united)


@dataclass(frozen=True, slots=True)
class _Outage:
    """A stretch without velocity, at most `OUTAGE_S` long.

    Attributes:
        begin_ns, end_ns: of it.
        deviation_m: standard deviation of the way within it that the odometry states, per axis.
    """

    begin_ns: int
    end_ns: int
    deviation_m: float

    def seconds_within(self, begin_ns: int, end_ns: int) -> float:
        """How long it lasts between two times."""
        return max(min(end_ns, self.end_ns) - max(begin_ns, self.begin_ns), 0) / 1e9


def _outages(track: OdometryTrack) -> list[_Outage]:
    """Find where velocity was missing: the stated deviation grows by more than it usually does.

    Growth is compared over `GROWTH_WINDOW_S`, for odometry states it in steps. Within an outage the
    error of the velocity stays alike, so deviations add up; variances of different ones do.
    """
    t_s = (track.t_ns - track.t_ns[0]) / 1e9
    way_m = np.hypot(*np.diff(track.position_m[:, :2], axis=0, prepend=track.position_m[:1, :2]).T)
    path_m, deviation_m = np.cumsum(way_m), track.deviation_m
    ends_s = [t_s + sign * GROWTH_WINDOW_S / 2 for sign in (-1, 1)]
    before_m, after_m = (
        np.column_stack([np.interp(end_s, t_s, values) for values in (deviation_m, path_m)])
        for end_s in ends_s
    )
    grown_m, driven_m = (after_m - before_m).T
    is_lost = is_outage(grown_m, driven_m, GROWTH_WINDOW_S)
    is_lost = is_lost[1:] & is_lost[:-1] & (np.diff(track.segment) == 0)
    rises = np.diff(deviation_m) > MIN_OUTAGE_SHARE * way_m[1:]
    found = []
    for lost, group in itertools.groupby(range(1, len(t_s)), key=lambda k: bool(is_lost[k - 1])):
        steps = [k for k in group if rises[k - 1]]
        if not lost or not steps:
            continue
        begin, end = steps[0] - 1, steps[-1]
        count = max(math.ceil((t_s[end] - t_s[begin]) / OUTAGE_S), 1)
        parts_s = np.linspace(t_s[begin], t_s[end], count + 1)
        variance_m2 = np.interp(parts_s, t_s, deviation_m) ** 2
        grown_m2 = np.maximum(np.diff(variance_m2), 0.0)
        parts_ns = track.t_ns[0] + np.round(parts_s * 1e9).astype(np.int64)
        found += [
            _Outage(int(parts_ns[n]), int(parts_ns[n + 1]), math.sqrt(grown_m2[n] / 2))
            for n in range(count)
        ]
    return found


def odometry_steps(track: OdometryTrack, t_ns: NDArray[np.int64]) -> list[OdometryStep | None]:
    """Return the odometry between times, and how far it can be trusted; None at the first.

    Args:
        track: the odometry.
        t_ns: (N,) increasing times.
    """
    poses, outages = track.at(t_ns), _outages(track)
    at = np.searchsorted(track.t_ns, t_ns).clip(0, len(track.t_ns) - 1)
    segment = track.segment[at].tolist()
    steps: list[OdometryStep | None] = [None]
    for k, (begin_ns, end_ns) in enumerate(itertools.pairwise(t_ns.tolist()), 1):
        inside = (track.t_ns > begin_ns) & (track.t_ns < end_ns)
        way_m = np.vstack([poses[k - 1, :2], track.position_m[inside, :2], poses[k, :2]])
        path_m = float(np.hypot(*np.diff(way_m, axis=0).T).sum())
        motion = compose(inverse(poses[k - 1]), poses[k])
        step = OdometryStep(motion, (end_ns - begin_ns) / 1e9, path_m)
        lost_s = [outage.seconds_within(begin_ns, end_ns) for outage in outages]
        if segment[k] != segment[k - 1]:
            step = replace(step, extra_std_m=JUMP_M, extra_std_rad=JUMP_RAD)
        elif max(lost_s, default=0.0) > 0:
            most = int(np.argmax(lost_s))
            outage_std_m = sum(
                outage.deviation_m * seconds / outage.seconds_within(outage.begin_ns, outage.end_ns)
                for outage, seconds in zip(outages, lost_s, strict=True)
                if seconds > 0
            )
            step = replace(step, outage_std_m=outage_std_m, outage=most)
        steps.append(step)
    return steps


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
    singles = []
    for k, dive in enumerate(dives):

        def part(share: float, what: str, k: int = k, name: str = dive.name) -> None:
            progress((k + share) / len(dives), f"{name}: {what}")

        singles.append(_SingleDive.align(dive, options, part))
    if len(dives) == 1:
        return singles[0].result()
    return _align_jointly(singles, options)


@dataclass(eq=False)
class _SingleDive:
    """A dive that was aligned by itself."""

    dive: _DiveNodes
    graph: PoseGraph
    solution: Solution
    odometry_deviation_m: float
    tried: int
    rejected: Counter[str] = field(default_factory=Counter)

    @classmethod
    def align(cls, given: DiveInput, options: AlignOptions, progress: Progress) -> "_SingleDive":
        """Align in two passes: the second has submaps that follow the trajectory of the first.

        The odometry also drifts within a submap, which shears it.
        """
        progress(0.0, "mapping")
        dive = _DiveNodes.of(given, given.read(None))
        start = dive.odometry
        frame, has_heading = dive.frame_by_fixes()
        if given.frame is not None:
            frame = given.frame
        graph = PoseGraph(compose(frame[None], start), dive.steps, options.drift)
        graph.solve()
        graph.prepare_covariances()
        odometry_deviation_m = _deviation_m(graph)
        graph.fixes = dive.fixes(0)
        if graph.fixes and given.frame is None:
            free = FREE_POSE_STD if has_heading else FREE_POSITION_STD
            graph.anchors = [PoseAnchor(0, graph.start[0], free)]
        graph.solve()
        first = LoopFinder(dive.submaps, dive.of_submap, options.threads)
        motion = LoopFinder(dive.fragments, dive.of_fragment, options.threads)
        progress(0.3, "registering")
        trials = _predicted_trials(motion.neighbours(), dive.of_fragment, graph, NEIGHBOUR_NOISE)
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
        trials = _predicted_trials(motion.neighbours(), dive.of_fragment, graph, SECOND_PASS_NOISE)
        again_trials = _predicted_trials(pairs, dive.of_submap, graph, SECOND_PASS_NOISE)
        graph.loops = motion.register(trials) + finder.register(again_trials)
        _close_loops(graph, finder, pairs)
        graph.reduce_neighbour_deviations()
        solution = graph.solve()
        tried, rejected = first.tried + finder.tried, first.rejected + finder.rejected
        return cls(dive, graph, solution, odometry_deviation_m, tried, rejected)

    def result(self) -> Alignment:
        """Judge the alignment of this dive alone."""
        covariance = self.graph.prepare_covariances()
        figures, reason = _judge(self.graph, self.odometry_deviation_m)
        figures |= _fix_figures(self.graph, self.dive.unreachable)
        if reason:
            aligned = self.refused()
        else:
            aligned = _result_of(self.dive, self.solution.poses, covariance, self.solution.drift)
        return Alignment(
            [aligned], self.graph.loops, not reason, reason, self.tried, self.rejected, figures
        )

    def map_at(self, frame: Floats) -> Submap | None:
        """The map of the whole dive at its aligned poses, moved by a planar transform."""
        poses = self.solution.poses[self.dive.of_submap]
        return joined_submap(self.dive.submaps, compose(frame[None], poses))

    def refused(self) -> AlignedDive:
        """The dive as its odometry has it, in its own frame; all registrations are refused."""
        for loop in self.graph.loops:
            loop.weight = 0.0
        poses = compose(self.dive.own_frame[None], self.dive.odometry)
        odometry_graph = PoseGraph(poses, self.dive.steps, self.graph.model)
        solution = odometry_graph.solve()
        return _result_of(self.dive, poses, odometry_graph.prepare_covariances(), solution.drift)


def _result_of(dive: _DiveNodes, poses: Floats, covariance: Floats, drift: Floats) -> AlignedDive:
    frame = compose(poses[0], inverse(dive.odometry[0]))
    return AlignedDive(
        dive.given.name, dive.t_ns, dive.odometry, poses, covariance, drift, frame, dive.track
    )


def _close_loops(
    graph: PoseGraph, finder: LoopFinder, known: Sequence[Pair], rounds: int = MAX_ROUNDS
) -> tuple[Solution, list[Pair]]:
    """Register revisits, the best predicted first, until there are no more."""
    solution, tried = graph.solve(), list(known)
    for _ in range(rounds):
        graph.prepare_covariances()
        trials = finder.loops(graph, tried, MAX_PARTNERS)
        if not trials:
            break
        tried += [trial.pair for trial in trials]
        graph.loops += finder.register(trials)
        solution = graph.solve()
    return solution, tried


def _predicted_trials(
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


def _deviation_m(graph: PoseGraph, first: int = 0, end: int | None = None) -> float:
    """Mean horizontal standard deviation of a dive's nodes, relative to the first of them.

    `prepare_covariances` must have been called since the last change.
    """
    nodes = range(first, len(graph.poses) if end is None else end)
    covariance = graph.covariance_of(first, nodes)
    return float(np.sqrt(np.maximum(covariance[:, 0, 0] + covariance[:, 1, 1], 0)).mean())


def _judge(graph: PoseGraph, odometry_deviation_m: float) -> tuple[dict[str, float], str]:
    """Return what the verdict rests on, and why the result must not be used; empty if it may.

    Fixes correct a dive without revisits, too; but revisits must not contradict them.
    """
    loops = [loop for loop in graph.loops if not loop.neighbours]
    accepted = [loop for loop in loops if loop.accepted]
    fixes = sum(fix.accepted for fix in graph.fixes)
    has_enough_fixes = fixes >= MIN_FIXES
    deviation_m = _deviation_m(graph)
    correction_m = _rms_from_start_m(graph.start, graph.poses)
    split_m = _split_m(graph, accepted)
    figures = {
        "revisits_found": float(len(loops)),
        "revisits_accepted": float(len(accepted)),
        "odometry_deviation_m": odometry_deviation_m,
        "deviation_m": deviation_m,
        "correction_m": correction_m,
        "split_m": split_m,
        "registration_scale": float(graph.bias[0]),
        "registration_turn": float(graph.bias[1]),
        "neighbour_deviation_factor": graph.neighbour_factor,
    }
    if len(accepted) < MIN_LOOPS and not has_enough_fixes:
        found = f"{len(accepted)} revisits" if accepted else "no revisit"
        return figures, f"{found} could be registered, and {MIN_LOOPS} are needed"
    if len(accepted) < MIN_ACCEPTED_SHARE * len(loops):
        return figures, f"{len(loops) - len(accepted)} of {len(loops)} revisits contradict the rest"
    if deviation_m > MAX_UNCERTAINTY_SHARE * odometry_deviation_m and not has_enough_fixes:
        return figures, _uncertainty_reason(deviation_m, odometry_deviation_m)
    if correction_m < MIN_CORRECTION_DEVIATIONS * deviation_m and not fixes:
        return figures, (
            f"the correction is {correction_m:.2f} m, and its standard deviation "
            f"{deviation_m:.2f} m"
        )
    return figures, _split_reason(split_m, correction_m)


def _fix_figures(graph: PoseGraph | None, unreachable: int) -> dict[str, float]:
    """Count the fixes that the graph holds, and those that no trajectory reaches."""
    figures = {"fixes_unreachable": float(unreachable)} if unreachable else {}
    if graph is not None and graph.fixes:
        figures["fixes"] = float(len(graph.fixes))
        figures["fixes_accepted"] = float(sum(fix.accepted for fix in graph.fixes))
    return figures


def _uncertainty_reason(deviation_m: float, odometry_deviation_m: float) -> str:
    share = deviation_m / max(odometry_deviation_m, 1e-9)
    return f"the revisits leave {share:.0%} of the uncertainty of the odometry"


def _split_reason(split_m: float, correction_m: float) -> str:
    """Return that two halves of the revisits disagree; empty if they agree."""
    if split_m <= max(MAX_SPLIT_M, MAX_SPLIT_SHARE * correction_m):
        return ""
    return (
        f"two halves of the revisits give trajectories {split_m:.2f} m apart, and the correction "
        f"is {correction_m:.2f} m"
    )


def _rms_from_start_m(a: Floats, b: Floats) -> float:
    """RMS distance of two trajectories (N, 3) that begin at the same pose."""
    a, b = (compose(inverse(one[0])[None], one) for one in (a, b))
    return _rms_m(a, b)


def _rms_m(a: Floats, b: Floats) -> float:
    return float(np.sqrt(((a[:, :2] - b[:, :2]) ** 2).sum(axis=1).mean()))


def _split_m(graph: PoseGraph, accepted: Sequence[Loop]) -> float:
    """RMS distance of the trajectories by two halves of the revisits."""
    loops, states = list(graph.loops), graph.save()
    kept = [(loop, loop.weight, loop.chosen) for loop in loops]
    fixes = [(fix, fix.weight) for fix in graph.fixes]
    halves = []
    for half in (0, 1):
        left = {id(loop) for loop in accepted[half::2]}
        graph.loops = [loop for loop in loops if loop.neighbours or id(loop) in left]
        halves.append(graph.solve().poses)
    graph.loops = loops
    graph.restore(states)
    for loop, weight, chosen in kept:
        loop.weight, loop.chosen = weight, chosen
    for fix, weight in fixes:
        fix.weight = weight
    return _rms_m(*halves)


def _align_jointly(singles: list[_SingleDive], options: AlignOptions) -> Alignment:
    """Join dives that were aligned by themselves in one graph."""
    first = np.cumsum([0, *(len(single.dive.t_ns) for single in singles)])
    frames, reason = _frames_of(singles)
    tried = sum(single.tried for single in singles)
    rejected = sum((single.rejected for single in singles), Counter[str]())
    unreachable = sum(single.dive.unreachable for single in singles)
    if reason:
        dives = [single.refused() for single in singles]
        loops, figures = _shifted_loops(singles, first), _fix_figures(None, unreachable)
        return Alignment(dives, loops, False, reason, tried, rejected, figures)  # noqa: FBT003
    start = np.vstack(
        [
            compose(frame[None], single.graph.start)
            for frame, single in zip(frames, singles, strict=True)
        ]
    )
    graph = PoseGraph(
        start, [step for single in singles for step in single.dive.steps], options.drift
    )
    graph.anchors = _anchors_of(singles, frames, first)
    graph.fixes = [
        fix for k, single in enumerate(singles) for fix in single.dive.fixes(int(first[k]))
    ]
    graph.loops = _shifted_loops(singles, first)
    poses = [
        compose(f[None], single.solution.poses) for f, single in zip(frames, singles, strict=True)
    ]
    graph.begin_at(
        np.vstack(poses),
        np.vstack([single.solution.drift for single in singles]),
        np.vstack([single.graph.mean_drift for single in singles]),
        np.vstack([single.graph.outages for single in singles]),
    )
    submaps = [submap for single in singles for submap in single.dive.submaps]
    nodes = [int(first[k]) + n for k, single in enumerate(singles) for n in single.dive.of_submap]
    dive_of = [k for k, single in enumerate(singles) for _ in single.dive.submaps]
    finder = LoopFinder(submaps, nodes, options.threads, dive_of=dive_of)
    solution = graph.solve()
    solution, _ = _close_loops(graph, finder, (), MAX_ROUNDS_BETWEEN_DIVES)
    covariance = graph.prepare_covariances()
    figures, reason = _judge_jointly(singles, graph, first)
    figures |= _fix_figures(graph, unreachable)
    dives = []
    for k, single in enumerate(singles):
        part = slice(int(first[k]), int(first[k + 1]))
        poses_of, drift = solution.poses[part], solution.drift[part]
        dives.append(
            single.refused()
            if reason
            else _result_of(single.dive, poses_of, covariance[part], drift)
        )
    if reason:
        for loop in graph.loops:
            loop.weight = 0.0
    tried, rejected = tried + finder.tried, rejected + finder.rejected
    return Alignment(dives, graph.loops, not reason, reason, tried, rejected, figures)


def _shifted_loops(singles: list[_SingleDive], first: NDArray[np.int64]) -> list[Loop]:
    """The loops of all dives, with nodes that count over all dives."""
    return [
        replace(loop, i=loop.i + int(first[k]), j=loop.j + int(first[k]))
        for k, single in enumerate(singles)
        for loop in single.graph.loops
    ]


def _frames_known(singles: Sequence[_SingleDive]) -> list[bool]:
    """Whether the frame of each dive is known, by itself or by fixes; if of none, the first's."""
    known = [single.dive.given.frame is not None or bool(single.graph.fixes) for single in singles]
    return known if any(known) else [True] + [False] * (len(known) - 1)


def _anchors_of(
    singles: list[_SingleDive], frames: list[Floats], first: NDArray[np.int64]
) -> list[PoseAnchor]:
    """First poses: their own where the frame is known, else as they were found."""
    anchors = []
    for k, (single, known) in enumerate(zip(singles, _frames_known(singles), strict=True)):
        [own] = single.graph.anchors
        deviation = own.deviation if known else REGISTERED_FRAME_STD
        anchors.append(PoseAnchor(int(first[k]), compose(frames[k], own.pose), deviation))
    return anchors


def _judge_jointly(
    singles: list[_SingleDive], graph: PoseGraph, first: NDArray[np.int64]
) -> tuple[dict[str, float], str]:
    """Return what the verdict rests on, and why the result must not be used; empty if it may."""
    dive_of_node = np.repeat(np.arange(len(singles)), np.diff(first))
    revisits = [loop for loop in graph.loops if not loop.neighbours]
    between = [loop for loop in revisits if dive_of_node[loop.i] != dive_of_node[loop.j]]
    accepted = [loop for loop in revisits if loop.accepted]
    split_m = _split_m(graph, accepted)
    corrections_m, reason = [], ""
    for k, (single, known) in enumerate(zip(singles, _frames_known(singles), strict=True)):
        begin, end = int(first[k]), int(first[k + 1])
        corrections_m.append(_rms_from_start_m(graph.start[begin:end], graph.poses[begin:end]))
        reason = reason or _unusable_reason(single, k, revisits, dive_of_node, known=known)
        deviation_m = _deviation_m(graph, begin, end)
        fixes = sum(fix.accepted for fix in graph.fixes if begin <= fix.node < end)
        before_m = single.odometry_deviation_m
        if not reason and deviation_m > MAX_UNCERTAINTY_SHARE * before_m and fixes < MIN_FIXES:
            reason = f"{single.dive.given.name}: {_uncertainty_reason(deviation_m, before_m)}"
    figures = {
        "revisits_between_dives": float(len(between)),
        "revisits_between_dives_accepted": float(sum(loop.accepted for loop in between)),
        "correction_m": max(corrections_m),
        "split_m": split_m,
        "registration_scale": float(graph.bias[0]),
        "registration_turn": float(graph.bias[1]),
    }
    return figures, reason or _split_reason(split_m, max(corrections_m))


def _unusable_reason(
    single: _SingleDive,
    k: int,
    revisits: Sequence[Loop],
    dive_of_node: NDArray[np.intp],
    *,
    known: bool,
) -> str:
    """Return why the revisits of a dive do not hold it; empty if they do."""
    name = single.dive.given.name
    own = [loop for loop in revisits if k in (dive_of_node[loop.i], dive_of_node[loop.j])]
    accepted = [loop for loop in own if loop.accepted]
    has_enough_fixes = sum(fix.accepted for fix in single.graph.fixes) >= MIN_FIXES
    if len(accepted) < MIN_LOOPS and not has_enough_fixes:
        return f"{name}: {len(accepted)} revisits could be registered, and {MIN_LOOPS} are needed"
    if len(accepted) < MIN_ACCEPTED_SHARE * len(own):
        return f"{name}: {len(own) - len(accepted)} of {len(own)} revisits contradict the rest"
    count = sum(dive_of_node[loop.i] != dive_of_node[loop.j] for loop in accepted)
    if known or count >= MIN_BETWEEN_DIVES:
        return ""
    return (
        f"{name}: {count} of its submaps could be registered to other dives, and "
        f"{MIN_BETWEEN_DIVES} are needed"
    )


def _frames_of(singles: list[_SingleDive]) -> tuple[list[Floats], str]:
    """Find how each dive must be moved into the common frame, or why one cannot be placed."""
    frames = [np.zeros(3) for _ in singles]
    known = _frames_known(singles)
    placed = [
        single.map_at(np.zeros(3))
        for single, is_known in zip(singles, known, strict=True)
        if is_known
    ]
    targets = [whole for whole in placed if whole is not None]
    for k, single in enumerate(singles):
        if known[k]:
            continue
        whole = single.map_at(np.zeros(3))
        if whole is None or not targets:
            return [], f"{single.dive.given.name}: too few echoes to register it to other dives"
        found = [register_dives(target, whole) for target in targets]
        best = max(found, key=lambda one: one[1])
        if isinstance(best[0], str):
            return [], f"{single.dive.given.name}: {best[0]}"
        frames[k] = best[0]
        moved = single.map_at(best[0])
        if moved is not None:
            targets.append(moved)
    return frames, ""
