"""The pose graph: odometry with drift, registrations and position fixes, solved robustly.

Each node has a planar pose and three errors of the odometry that hold there: scale, crab (the
direction of travel turns against the heading) and turn (the rate of the heading). These wander
about their means over the dive as Ornstein-Uhlenbeck processes, so drift may be constant or change.
The means, which are states too, carry what is known of the drift through a gap. While velocity is
missing, its error is one state for the whole outage. Loops are robust
(Geman-McClure with graduated non-convexity: Yang, Antonante, Tzoumas and Carlone 2020); a loop may
have several alternatives, of which the most likely counts (max-mixture: Olson and Agarwal 2013).

Registrations err, too: echoes of unknown elevation are placed too near or too far, alike in all
submaps. Two errors, common to all loops, are estimated: a scale of the way between the submaps, and
a turn about the middle of the second, proportional to the sine of the turn between them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

__all__ = [
    "MIN_INFORMATION",
    "DriftModel",
    "Loop",
    "OdometryStep",
    "PoseAnchor",
    "PoseGraph",
    "PositionFix",
    "Solution",
]

Floats = NDArray[np.float64]

STATES = 6
"""x, y, yaw, scale, crab, turn of a node."""

GATE = 11.34
"""Squared Mahalanobis distance of 3 degrees of freedom that 99 % of right loops stay below."""

MAX_RESIDUAL_M = 0.9
"""A registration that is further off is refused, also along a direction that it leaves open."""

FIX_GATE = 9.21
"""The same of a position fix, 2 degrees of freedom."""

STEP_GATE, MIN_STEP_WEIGHT = 16.0, 1e-4
"""The same of a step of the odometry: where velocity fails it errs by far more than it drifts. Its
weight stays above a minimum: a failed step is a hundred times as uncertain, not unlimited."""

STEP_NARROWING = (1.0, 0.5)
"""While the kernels of loops are widened by a factor, those of steps are widened by this power of
it: with 0.5 a failed step gives way before the loops about it."""

OUTAGE_WANDER_S, MAX_KERNEL_SHARE = 0.3, 0.15
"""Time over which a missing velocity may differ from that of its whole outage; share of the way
that a step may miss and still give way: one that misses more is as uncertain as it states."""

MIN_DEVIATION_FACTOR, MIN_REDUNDANCY = 0.4, 30.0
"""Lower limit of the factor on deviations, and minimum redundancy for its estimate."""

MIN_INFORMATION = 1e-6
"""Information, 1/m2, below which a direction is open."""

ACCEPTED_WEIGHT = 0.3
MAX_STEPS = 60
EXACT = np.array([1e-6, 1e-6, 1e-6])
STOP = 1e-5


@dataclass(frozen=True, slots=True)
class DriftModel:
    """How odometry drifts and how registrations err alike; one standard deviation each.

    Scale, crab and turn have a mean over the dive, and wander about it: each has the given
    deviation, so the variance of both is twice as large.

    Attributes:
        scale: error of distances, as a share.
        crab_rad: angle between the course made good and the stated one.
        turn_radps: drift of the heading.
        memory_s: time over which the deviations from the mean stay alike.
        noise_m: of a step, for each square root of a metre travelled.
        noise_rad: of a step, for each square root of a second.
        registration_scale: error of the distance between registered submaps, as a share.
        registration_turn: error of the turn between them, as a share of its sine.
    """

    scale: float = 0.03
    crab_rad: float = 0.03
    turn_radps: float = math.radians(3.0) / 60.0
    memory_s: float = 60.0
    noise_m: float = 0.02
    noise_rad: float = math.radians(0.05)
    registration_scale: float = 0.007
    registration_turn: float = 0.02

    @property
    def deviations(self) -> Floats:
        """(3,) of scale, crab (rad) and turn (rad/s)."""
        return np.array([self.scale, self.crab_rad, self.turn_radps])


@dataclass(frozen=True, slots=True, eq=False)
class OdometryStep:
    """Odometry between two nodes that follow each other.

    Attributes:
        motion: (3,) planar pose of the later node in the earlier one.
        seconds: between them.
        path_m: length of the way between them.
        extra_std_m, extra_std_rad: further standard deviations, after a jump.
        outage_std_m: standard deviation, per axis, of the way while velocity was missing.
        outage: number, in its dive, of the outage that the step belongs to. Its steps share the
            error of the velocity, in the axes of the vehicle.
    """

    motion: Floats
    seconds: float
    path_m: float
    extra_std_m: float = 0.0
    extra_std_rad: float = 0.0
    outage_std_m: float = 0.0
    outage: int | None = None


@dataclass(eq=False)
class Loop:
    """A registration between two nodes.

    Attributes:
        i, j: target and source.
        poses: (K, 3) alternatives of i_T_j, the best first.
        information: (K, 3, 3) of x, y in the axes of i, and yaw.
        neighbours: whether the nodes follow each other closely, so that this is no revisit.
        centre: (2,) middle of the submap at j, in its frame.
        scores: (K,) agreement of the submaps, 0..1.
        weight: 0..1 after solving; below `ACCEPTED_WEIGHT` the loop is refused.
        chosen: index of the alternative that counts.
    """

    i: int
    j: int
    poses: Floats
    information: Floats
    neighbours: bool
    scores: Floats
    centre: Floats
    weight: float = 1.0
    chosen: int = 0

    @property
    def accepted(self) -> bool:
        """Whether the solution uses it."""
        return self.weight >= ACCEPTED_WEIGHT


@dataclass(frozen=True, slots=True, eq=False)
class PoseAnchor:
    """A known pose of a node.

    Attributes:
        node: index.
        pose: (3,) in the frame of the result.
        deviation: (3,) standard deviations of x, y (m) and yaw (rad).
    """

    node: int
    pose: Floats
    deviation: Floats


@dataclass(eq=False)
class PositionFix:
    """A known position of a node, such as by GPS at the surface.

    Attributes:
        node: index.
        position_m: (2,) in the frame of the result.
        deviation_m: one standard deviation.
        weight: 0..1 after solving; below `ACCEPTED_WEIGHT` the fix is refused.
    """

    node: int
    position_m: Floats
    deviation_m: float
    weight: float = 1.0

    @property
    def accepted(self) -> bool:
        """Whether the solution uses it."""
        return self.weight >= ACCEPTED_WEIGHT


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved graph.

    Attributes:
        poses: (N, 3) of the nodes.
        drift: (N, 3) scale, crab (rad) and turn (rad/s).
    """

    poses: Floats
    drift: Floats


def wrapped(angle: Floats) -> Floats:
    """The same angles in -pi to pi."""
    return np.remainder(angle + math.pi, 2 * math.pi) - math.pi


def measured_by(centre: Floats, relative: Floats, bias: Floats) -> tuple[Floats, Floats, Floats]:
    """What registrations measure of i_T_j if they err alike.

    Args:
        centre: (L, 2) middle of the submap at j.
        relative: (L, 3) i_T_j.
        bias: (2,) as `PoseGraph.bias`.

    Returns:
        (L, 3), its derivatives by i_T_j (L, 3, 3) and by the bias (L, 3, 2).
    """
    scale, gain = bias
    c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
    x, y = centre.T
    # The lever from the centre to the submap's origin, turned by a right angle.
    across = np.column_stack([s * x + c * y, -(c * x - s * y)])
    moved = (1 + scale) * relative[:, :2] + gain * s[:, None] * across
    measured = np.column_stack([moved, relative[:, 2] + gain * s])
    by_pose = np.zeros((len(relative), 3, 3))
    by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1 + scale
    by_pose[:, 2, 2] = 1 + gain * c
    turned = np.column_stack([c * x - s * y, s * x + c * y])
    by_pose[:, :2, 2] = gain * (c[:, None] * across + s[:, None] * turned)
    by_bias = np.zeros((len(relative), 3, 2))
    by_bias[:, :2, 0] = relative[:, :2]
    by_bias[:, :2, 1] = s[:, None] * across
    by_bias[:, 2, 1] = s
    return measured, by_pose, by_bias


@dataclass(eq=False)
class PoseGraph:
    """A chain of nodes for each dive, and registrations between any nodes.

    Args:
        start: (N, 3) poses from the odometry, where the solution begins.
        steps: N entries: the odometry from the node before; None at the first node of a dive.
        model: of the drift.

    Attributes:
        loops: registrations.
        fixes: known positions.
        anchors: known poses: at first that of node 0.
        bias: (2,) common errors of the registrations: scale of the distance, and turn about the
            middle of the second submap by the sine of the turn between them.
        mean_drift: (D, 3) of each dive: scale, crab (rad) and turn (rad/s).
        outages: (O, 2) of each outage: error of the velocity ahead and to port, in units of its
            standard deviation.
        neighbour_factor: see `reduce_neighbour_deviations`.
    """

    start: Floats
    steps: Sequence[OdometryStep | None]
    model: DriftModel
    loops: list[Loop] = field(default_factory=list)
    fixes: list[PositionFix] = field(default_factory=list)
    anchors: list[PoseAnchor] = field(default_factory=list)
    _states: Floats = field(init=False)
    bias: Floats = field(init=False)
    mean_drift: Floats = field(init=False)
    outages: Floats = field(init=False)
    neighbour_factor: float = field(default=1.0, init=False)
    _outage_of: NDArray[np.intp] = field(init=False)
    _dive_of: NDArray[np.intp] = field(init=False)
    _later: NDArray[np.intp] = field(init=False)
    _step_weights: Floats = field(init=False)
    _sparsity: "_Sparsity | None" = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._states = np.hstack([self.start, np.zeros_like(self.start)])
        self.bias = np.zeros(2)
        self._dive_of = np.cumsum([step is None for step in self.steps]) - 1
        self.mean_drift = np.zeros((int(self._dive_of[-1]) + 1, 3))
        self._step_weights = np.ones(len(self.start))
        self._later = np.flatnonzero([step is not None for step in self.steps])
        numbers: dict[tuple[int, int], int] = {}
        self._outage_of = np.full(len(self._later), -1, dtype=np.intp)
        for k, node in enumerate(self._later.tolist()):
            step = self.steps[node]
            if step is not None and step.outage is not None:
                key = int(self._dive_of[node]), step.outage
                self._outage_of[k] = numbers.setdefault(key, len(numbers))
        self.outages = np.zeros((len(numbers), 2))
        if not self.anchors:
            self.anchors = [PoseAnchor(0, self.start[0].copy(), EXACT)]

    def save(self) -> tuple[Floats, ...]:
        """Return the present states, for `restore`."""
        present = self._states, self._step_weights, self.bias, self.mean_drift, self.outages
        return tuple(array.copy() for array in present)

    def restore(self, saved: tuple[Floats, ...]) -> None:
        """Return to states of `save`."""
        self._states, self._step_weights, self.bias, self.mean_drift, self.outages = (
            array.copy() for array in saved
        )

    def begin_at(self, poses: Floats, drift: Floats, mean_drift: Floats, outages: Floats) -> None:
        """Begin from other states: poses and drift, (N, 3) each; see the class for the others."""
        self._states = np.hstack([poses, drift])
        self.mean_drift, self.outages = mean_drift.copy(), outages.copy()

    @property
    def poses(self) -> Floats:
        """(N, 3) present poses."""
        return self._states[:, :3]

    def solve(self) -> Solution:
        """Solve the graph; sets weight and chosen alternative of all loops.

        Where velocity failed, either the step or the loops about it give way: those whose kernel
        narrows first. Both orders are tried, and the lower cost counts.
        """
        begin = self.save()
        ends = []
        for narrowing in STEP_NARROWING:
            self.restore(begin)
            self._minimize(narrowing)
            ends.append((self._cost(), self.save()))
        self.restore(min(ends, key=lambda end: end[0])[1])
        self._weigh()
        for loop, apart in zip(self.loops, self._loop_factors()[1], strict=True):
            if math.hypot(apart[0], apart[1]) > MAX_RESIDUAL_M:
                loop.weight = 0.0
        return Solution(self._states[:, :3].copy(), self._states[:, 3:].copy())

    def _minimize(self, narrowing: float) -> None:
        """Minimize by graduated non-convexity: the kernel starts wide enough to be convex."""
        for loop in self.loops:
            loop.weight = 1.0
        self._step_weights[:] = 1.0
        squared = [distance / GATE for distance in self._loop_distances()[0].tolist()]
        squared += [self._distance_of_fix(fix) / FIX_GATE for fix in self.fixes]
        control = max(1.0, 2 * max(squared, default=0.0))
        while True:
            last = control <= 1.0
            for _ in range(MAX_STEPS if last else 4):
                self._weigh(control, control**narrowing)
                if self._gauss_newton_step() < STOP:
                    break
            if last:
                break
            control = max(1.0, control / 2.0)
        self._weigh()

    def _cost(self) -> float:
        """The robust cost at the present states and weights."""
        penalty = sum(GATE * (1 - math.sqrt(loop.weight)) ** 2 for loop in self.loops)
        penalty += sum(FIX_GATE * (1 - math.sqrt(fix.weight)) ** 2 for fix in self.fixes)
        penalty += float((STEP_GATE * (1 - np.sqrt(self._step_weights)) ** 2).sum())
        return self._linearized().squared + penalty

    def _weigh(self, control: float = 1.0, step_control: float = 1.0) -> None:
        squared, chosen = self._loop_distances()
        weights = (control * GATE / (control * GATE + squared)) ** 2
        for loop, weight, best in zip(self.loops, weights.tolist(), chosen.tolist(), strict=True):
            loop.weight, loop.chosen = weight, best
        for fix in self.fixes:
            limit = control * FIX_GATE
            fix.weight = (limit / (limit + self._distance_of_fix(fix))) ** 2
        _, residuals, information = self._step_factors()
        limit = step_control * STEP_GATE
        weights = (limit / (limit + (residuals**2 * information).sum(axis=1))) ** 2
        missed = self._of_steps("outage_std_m") > MAX_KERNEL_SHARE * self._of_steps("path_m")
        weights = np.where(missed, 1.0, np.maximum(weights, MIN_STEP_WEIGHT))
        self._step_weights[self._later] = weights

    def _loop_distances(self) -> tuple[Floats, NDArray[np.intp]]:
        """Of each loop, the least squared Mahalanobis distance of the alternatives, and which."""
        counts = [len(loop.poses) for loop in self.loops]
        if not counts:
            return np.zeros(0), np.zeros(0, dtype=np.intp)
        *_, relative, centre = self._loop_ends()
        measured, _, _ = measured_by(centre, relative, self.bias)
        residuals = np.repeat(measured, counts, axis=0)
        residuals -= np.concatenate([loop.poses for loop in self.loops])
        residuals[:, 2] = wrapped(residuals[:, 2])
        information = np.concatenate([loop.information for loop in self.loops])
        squared = np.einsum("ki,kij,kj->k", residuals, information, residuals)
        parts = np.split(squared, np.cumsum(counts)[:-1])
        best = np.array([part.argmin() for part in parts])
        return np.array([part.min() for part in parts]), best

    def _distance_of_fix(self, fix: PositionFix) -> float:
        residual = self.poses[fix.node, :2] - fix.position_m
        return float(residual @ residual) / fix.deviation_m**2

    def _loop_ends(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Of the loops, the Jacobians (L, 3, 6) of i_T_j by i and j, i_T_j and the centre."""
        ends = np.array([(loop.i, loop.j) for loop in self.loops], dtype=np.intp).reshape(-1, 2)
        of_i, of_j, relative = self._relative(ends[:, 0], ends[:, 1], np.zeros((len(ends), 3)))
        centre = np.array([loop.centre for loop in self.loops]).reshape(-1, 2)
        return of_i, of_j, relative, centre

    def _loop_factors(self) -> tuple[Floats, Floats, Floats]:
        """Jacobians (L, 3, 18) by both nodes and the common errors, residuals and information."""
        of_i, of_j, relative, centre = self._loop_ends()
        measured, by_pose, by_bias = measured_by(centre, relative, self.bias)
        chosen = np.array([loop.poses[loop.chosen] for loop in self.loops]).reshape(-1, 3)
        residuals = measured - chosen
        residuals[:, 2] = wrapped(residuals[:, 2])
        of_bias = np.zeros((len(residuals), 3, STATES))
        of_bias[:, :, : by_bias.shape[2]] = by_bias
        information = np.array([one.weight * one.information[one.chosen] for one in self.loops])
        jacobians = np.concatenate([by_pose @ of_i, by_pose @ of_j, of_bias], axis=2)
        return jacobians, residuals, information.reshape(-1, 3, 3)

    def _gauss_newton_step(self) -> float:
        """Take one step of Gauss and Newton; return the largest change of a pose."""
        normal = self._linearized()
        change = self._factorized(normal).solve(-normal.gradient).reshape(-1, STATES)
        count = len(self._states)
        self._states += change[:count]
        self.bias += change[count, : len(self.bias)]
        dives = count + 1 + len(self.mean_drift)
        self.mean_drift += change[count + 1 : dives, 3:]
        self.outages += change[dives:, :2]
        self._states[:, 2] = wrapped(self._states[:, 2])
        return float(np.abs(change[:count, :3]).max())

    def _factorized(self, normal: "_NormalEquations") -> SuperLU:
        """Factors of the normal matrix, whose symmetry saves half of the time."""
        indices, values = normal.entries()
        if self._sparsity is None or not np.array_equal(self._sparsity.indices, indices):
            self._sparsity = _Sparsity(indices, normal.size)
        matrix, options = self._sparsity.matrix(values), {"SymmetricMode": True}
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def _linearized(self) -> "_NormalEquations":
        # Behind the nodes come one with the common errors of the registrations, one with the mean
        # drift of each dive, and one with the error of each outage. Their other states do nothing.
        bias_node = len(self._states)
        first_outage = bias_node + 1 + len(self.mean_drift)
        normal = _NormalEquations(first_outage + len(self.outages))
        for k, error in enumerate(self.outages):
            normal.add([first_outage + k], [np.eye(2, STATES)], error, np.eye(2))
            normal.add(
                [first_outage + k], [np.eye(STATES)], np.zeros(STATES), 1e-6 * np.eye(STATES)
            )
        deviation = np.array([self.model.registration_scale, self.model.registration_turn])
        of_bias = np.eye(len(deviation), STATES)
        normal.add([bias_node], [of_bias], self.bias, np.diag(deviation**-2.0))
        normal.add([bias_node], [np.eye(STATES)], np.zeros(STATES), 1e-6 * np.eye(STATES))
        for anchor in self.anchors:
            residual = self._states[anchor.node, :3] - anchor.pose
            residual[2] = math.remainder(residual[2], math.tau)
            information = np.diag(anchor.deviation**-2.0)
            normal.add([anchor.node], [np.eye(3, STATES)], residual, information)
        drift, spread = np.eye(3, STATES, 3), self.model.deviations
        for dive, mean in enumerate(self.mean_drift):
            own = [bias_node + 1 + dive]
            normal.add(own, [drift], mean, np.diag(spread**-2.0))
            normal.add(own, [np.eye(3, STATES)], np.zeros(3), 1e-6 * np.eye(3))
        means = bias_node + 1 + self._dive_of
        from_mean = self._states[:, 3:] - self.mean_drift[self._dive_of]
        for k in np.setdiff1d(np.arange(bias_node), self._later).tolist():
            both = [k, int(means[k])]
            normal.add(both, [drift, -drift], from_mean[k], np.diag(spread**-2.0))
        later = self._later
        keep = np.exp(-self._of_steps("seconds") / self.model.memory_s)[:, None, None]
        residuals = from_mean[later] - keep[:, :, 0] * from_mean[later - 1]
        variances = spread**2 * np.maximum(1 - keep[:, :, 0] ** 2, 1e-6)
        shares = np.concatenate([-keep, np.ones_like(keep), keep - 1], axis=2)
        jacobians = np.kron(shares, drift)
        nodes = np.column_stack([later - 1, later, means[later]])
        normal.add_many(nodes, jacobians, residuals, np.eye(3) / variances[:, None])
        jacobians, residuals, information = self._step_factors()
        information = (self._step_weights[later, None] * information)[:, None] * np.eye(3)
        lost = self._outage_of >= 0
        nodes[:, 2] = first_outage + self._outage_of
        for some, width in ((~lost, 2), (lost, 3)):
            columns = width * STATES
            normal.add_many(
                nodes[some, :width],
                jacobians[some, :, :columns],
                residuals[some],
                information[some],
            )
        ends = np.array([(loop.i, loop.j, bias_node) for loop in self.loops], dtype=np.intp)
        normal.add_many(ends.reshape(-1, 3), *self._loop_factors())
        for fix in self.fixes:
            residual = self._states[fix.node, :2] - fix.position_m
            information = fix.weight / fix.deviation_m**2 * np.eye(2)
            normal.add([fix.node], [np.eye(2, STATES)], residual, information)
        return normal

    def _of_steps(self, name: str) -> Floats:
        """(M, ...) an attribute of all steps."""
        return np.array([getattr(step, name) for step in self.steps if step is not None])

    def _step_factors(self) -> tuple[Floats, Floats, Floats]:
        """Jacobians (M, 3, 18) of the steps, residuals (M, 3), and information (M, 3).

        The Jacobians are by both nodes and the outage.
        """
        scale, crab, turn = self._states[self._later - 1, 3:].T
        seconds = self._of_steps("seconds")
        angle = crab + turn * seconds / 2
        c, s = np.cos(angle), np.sin(angle)
        x, y, yaw = self._of_steps("motion").reshape(-1, 3).T
        turned = np.column_stack([c * x - s * y, s * x + c * y])
        grown = (1 + scale)[:, None]
        across = grown * np.column_stack([-turned[:, 1], turned[:, 0]])
        outage_std_m = self._of_steps("outage_std_m")[:, None]
        half = yaw / 2
        ahead, port = (
            np.column_stack([np.cos(half), np.sin(half)]),
            np.column_stack([-np.sin(half), np.cos(half)]),
        )
        errors = np.vstack([self.outages, np.zeros((1, 2))])[self._outage_of]
        missed = outage_std_m * (errors[:, :1] * ahead + errors[:, 1:] * port)
        drifted = np.column_stack([grown * turned + missed, yaw + turn * seconds])
        of_a, of_b, residuals = self._relative(self._later - 1, self._later, drifted)
        of_a[:, :2, 3] -= turned
        of_a[:, :2, 4] -= across
        of_a[:, :2, 5] -= across * seconds[:, None] / 2
        of_a[:, 2, 5] -= seconds
        of_outage = np.zeros_like(of_a)
        of_outage[:, :2, 0], of_outage[:, :2, 1] = -outage_std_m * ahead, -outage_std_m * port
        model, path_m = self.model, np.maximum(self._of_steps("path_m"), 0.1)
        variance_m2 = model.noise_m**2 * path_m + 0.01**2 + self._of_steps("extra_std_m") ** 2
        variance_m2 += outage_std_m[:, 0] ** 2 * OUTAGE_WANDER_S / np.maximum(seconds, 1e-9)
        extra_rad = self._of_steps("extra_std_rad")
        variance_rad2 = model.noise_rad**2 * seconds + 1e-6 + extra_rad**2
        information = 1 / np.column_stack([variance_m2, variance_m2, variance_rad2])
        return np.concatenate([of_a, of_b, of_outage], axis=2), residuals, information

    def _relative(
        self, i: NDArray[np.intp], j: NDArray[np.intp], measured: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Jacobians (M, 3, 6) of i_T_j by the states of i and j; i_T_j less a measurement."""
        a, b = self._states[i, :3], self._states[j, :3]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b[:, :2] - a[:, :2]).T
        x, y = c * dx + s * dy, -s * dx + c * dy
        residuals = np.column_stack([x, y, b[:, 2] - a[:, 2]]) - measured
        residuals[:, 2] = wrapped(residuals[:, 2])
        of_i, of_j = np.zeros((2, len(a), 3, STATES))
        of_j[:, 0, 0], of_j[:, 0, 1] = c, s
        of_j[:, 1, 0], of_j[:, 1, 1] = -s, c
        of_j[:, 2, 2] = 1.0
        of_i[:, :, :3] = -of_j[:, :, :3]
        of_i[:, 0, 2], of_i[:, 1, 2] = y, -x
        return of_i, of_j, residuals

    def reduce_neighbour_deviations(self) -> float:
        """Reduce the deviations of registrations of neighbours if they fit better than stated.

        How well they fit depends on the scene. The factor is the root of their squared residuals
        over their redundancy: one step of estimating a variance component (Förstner 1979), which
        leaves it too large rather than too small. It has a lower limit, for an error that all
        registrations share shows in no residual. Revisits stay as they are: those between the same
        two headings share an error, too.

        Returns:
            The factor, for position and heading; 1 with too few registrations, or if they fit no
            better than stated.
        """
        jacobians, residuals, information = self._loop_factors()
        normal = self._linearized()
        factorized = self._factorized(normal)
        bias_node = len(self._states)
        neighbours = [k for k, loop in enumerate(self.loops) if loop.neighbours]
        squared = redundancy = 0.0
        for k in neighbours:
            loop = self.loops[k]
            nodes = np.array([loop.i, loop.j, bias_node])
            columns = np.zeros((normal.size, 3))
            columns[(nodes[:, None] * STATES + np.arange(STATES)).ravel()] = jacobians[k].T
            explained = np.einsum("ij,ij", information[k], columns.T @ factorized.solve(columns))
            held = (np.linalg.eigvalsh(loop.information[loop.chosen]) > MIN_INFORMATION).sum()
            squared += float(residuals[k] @ information[k] @ residuals[k])
            redundancy += loop.weight * float(held) - float(explained)
        if redundancy >= MIN_REDUNDANCY:
            factor = math.sqrt(squared / redundancy)
            self.neighbour_factor = min(max(factor, MIN_DEVIATION_FACTOR), 1.0)
            for k in neighbours:
                self.loops[k].information = self.loops[k].information / self.neighbour_factor**2
        return self.neighbour_factor

    def covariance_of(self, i: int, others: Sequence[int]) -> Floats:
        """Return the covariances (M, 3, 3) of i_T_j for some nodes j, without the loops' outliers.

        `prepare_covariances` must have been called since the last change.
        """
        joint, nodes = self._columns(i), np.array(others, dtype=np.intp)
        of_i, of_j, _ = self._relative(np.full(len(nodes), i), nodes, np.zeros((len(nodes), 3)))
        a, b = of_i[:, :, :3], of_j[:, :, :3]
        mixed = b @ joint[nodes] @ np.moveaxis(a, 1, 2)  # covariance of j with i
        own = a @ joint[i] @ np.moveaxis(a, 1, 2)
        other = b @ self._marginals[nodes] @ np.moveaxis(b, 1, 2)
        found: Floats = own + np.moveaxis(mixed, 1, 2) + mixed + other
        return found

    def prepare_covariances(self) -> Floats:
        """Factorize the present graph; return the covariance (N, 3, 3) of every node's pose."""
        count = len(self._states)
        self._factor = self._factorized(self._linearized())
        self._marginals = np.empty((count, 3, 3))
        for i in range(count):
            self._marginals[i] = self._columns(i)[i]
        return self._marginals

    def _columns(self, i: int) -> Floats:
        """(N, 3, 3) covariances of all poses with that of node i."""
        count = len(self._states)
        right = np.zeros((self._factor.shape[0], 3))
        right[i * STATES : i * STATES + 3] = np.eye(3)
        columns: Floats = self._factor.solve(right).reshape(-1, STATES, 3)[:count, :3]
        return columns


class _NormalEquations:
    """Normal equations, collected in blocks."""

    def __init__(self, nodes: int) -> None:
        self.size = nodes * STATES
        self.gradient = np.zeros(self.size)
        self.squared = 0.0
        self._rows: list[NDArray[np.intp]] = []
        self._columns: list[NDArray[np.intp]] = []
        self._values: list[Floats] = []

    def add(
        self, nodes: list[int], jacobians: list[Floats], residual: Floats, information: Floats
    ) -> None:
        """Add one factor; Jacobians by the states of each node, (R, 6) each."""
        jacobian = np.hstack(jacobians)[None]
        self.add_many(np.array([nodes]), jacobian, residual[None], information[None])

    def add_many(
        self, nodes: NDArray[np.intp], jacobians: Floats, residuals: Floats, information: Floats
    ) -> None:
        """Add M factors of N nodes: (M, N), (M, R, 6 N), (M, R) and (M, R, R)."""
        width = nodes.shape[1] * STATES
        indices = (nodes[:, :, None] * STATES + np.arange(STATES)).reshape(-1, width)
        weighted = np.moveaxis(jacobians, 1, 2) @ information
        np.add.at(self.gradient, indices, (weighted @ residuals[:, :, None])[:, :, 0])
        self.squared += float(np.einsum("mi,mij,mj->", residuals, information, residuals))
        self._rows.append(np.repeat(indices, width, axis=1).ravel())
        self._columns.append(np.tile(indices, (1, width)).ravel())
        self._values.append((weighted @ jacobians).ravel())

    def entries(self) -> tuple[NDArray[np.intp], Floats]:
        """Return indices in the matrix, column times size plus row, and values to add there."""
        indices = np.concatenate(self._columns) * self.size + np.concatenate(self._rows)
        return indices, np.concatenate(self._values)


class _Sparsity:
    """Where entries lie in a sparse matrix.

    Args:
        indices: of each entry, see `_NormalEquations.entries`.
        size: of the matrix.
    """

    def __init__(self, indices: NDArray[np.intp], size: int) -> None:
        self.indices = indices
        kept, self._number = np.unique(indices, return_inverse=True)
        self._rows = (kept % size).astype(np.int32)
        self._begins = np.searchsorted(kept, np.arange(size + 1) * size).astype(np.int32)

    def matrix(self, values: Floats) -> csc_array:
        """Return the matrix of such entries."""
        sums = np.bincount(self._number, values, len(self._rows))
        size = len(self._begins) - 1
        return csc_array((sums, self._rows, self._begins), shape=(size, size))
