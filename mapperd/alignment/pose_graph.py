"""The pose graph: odometry with drift, registrations and position fixes, solved robustly.

Each node has a planar pose and three errors of the odometry that hold there: scale, crab (the
direction of travel turns against the heading) and turn (the rate of the heading). These wander
about their means over the dive as Ornstein-Uhlenbeck processes, so drift may be constant or change.
The means, which are states too, carry what is known of the drift through a gap. Loops are robust
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
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from mapperd.alignment.submaps import compose, inverse

__all__ = [
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
        extra_std_m: further standard deviation: where velocity was missing, or after a jump.
        extra_std_rad: the same of the heading.
    """

    motion: Floats
    seconds: float
    path_m: float
    extra_std_m: float = 0.0
    extra_std_rad: float = 0.0


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
    _dive_of: NDArray[np.intp] = field(init=False)
    _step_weights: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._states = np.hstack([self.start, np.zeros_like(self.start)])
        self.bias = np.zeros(2)
        self._dive_of = np.cumsum([step is None for step in self.steps]) - 1
        self.mean_drift = np.zeros((int(self._dive_of[-1]) + 1, 3))
        self._step_weights = np.ones(len(self.start))
        if not self.anchors:
            self.anchors = [PoseAnchor(0, self.start[0].copy(), EXACT)]

    def save(self) -> tuple[Floats, ...]:
        """Return the present states, for `restore`."""
        present = self._states, self._step_weights, self.bias, self.mean_drift
        return tuple(array.copy() for array in present)

    def restore(self, saved: tuple[Floats, ...]) -> None:
        """Return to states of `save`."""
        self._states, self._step_weights, self.bias, self.mean_drift = (
            array.copy() for array in saved
        )

    def begin_at(self, poses: Floats, drift: Floats, mean_drift: Floats) -> None:
        """Begin from other poses and drift, (N, 3) each, and means of the drift, (D, 3)."""
        self._states = np.hstack([poses, drift])
        self.mean_drift = mean_drift.copy()

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
        for loop in self.loops:
            apart = self._loop_residuals(loop)[loop.chosen]
            if math.hypot(apart[0], apart[1]) > MAX_RESIDUAL_M:
                loop.weight = 0.0
        return Solution(self._states[:, :3].copy(), self._states[:, 3:].copy())

    def _minimize(self, narrowing: float) -> None:
        """Minimize by graduated non-convexity: the kernel starts wide enough to be convex."""
        for loop in self.loops:
            loop.weight = 1.0
        self._step_weights[:] = 1.0
        squared = [self._distance(loop)[0] / GATE for loop in self.loops]
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
        for loop in self.loops:
            squared, loop.chosen = self._distance(loop)
            loop.weight = (control * GATE / (control * GATE + squared)) ** 2
        for fix in self.fixes:
            limit = control * FIX_GATE
            fix.weight = (limit / (limit + self._distance_of_fix(fix))) ** 2
        for k, step in enumerate(self.steps):
            if step is not None:
                _, residual, information = self._step_factor(k, step)
                squared = float(residual @ information @ residual)
                limit = step_control * STEP_GATE
                weight = (limit / (limit + squared)) ** 2
                self._step_weights[k] = max(weight, MIN_STEP_WEIGHT)

    def _distance(self, loop: Loop) -> tuple[float, int]:
        """Return the least squared Mahalanobis distance of the alternatives, and which it is."""
        residual = self._loop_residuals(loop)
        squared = np.einsum("ki,kij,kj->k", residual, loop.information, residual)
        best = int(squared.argmin())
        return float(squared[best]), best

    def _loop_residuals(self, loop: Loop) -> Floats:
        """(K, 3) residuals of the alternatives."""
        relative = compose(inverse(self.poses[loop.i]), self.poses[loop.j])
        residual = self.measured_by(loop, relative)[0] - loop.poses
        residual[:, 2] = wrapped(residual[:, 2])
        return residual

    def _distance_of_fix(self, fix: PositionFix) -> float:
        residual = self.poses[fix.node, :2] - fix.position_m
        return float(residual @ residual) / fix.deviation_m**2

    def measured_by(self, loop: Loop, relative: Floats) -> tuple[Floats, Floats, Floats]:
        """Return what a loop measures of i_T_j (3,), and its derivatives by i_T_j and the bias."""
        scale, gain = self.bias
        c, s = math.cos(relative[2]), math.sin(relative[2])
        x, y = loop.centre
        # The lever from the centre to the submap's origin, turned by a right angle.
        across = np.array([s * x + c * y, -(c * x - s * y)])
        moved = (1 + scale) * relative[:2] + gain * s * across
        measured = np.append(moved, relative[2] + gain * s)
        by_pose = np.diag([1 + scale, 1 + scale, 1 + gain * c])
        by_pose[:2, 2] = gain * (c * across + s * np.array([c * x - s * y, s * x + c * y]))
        by_bias = np.array([(relative[0], s * across[0]), (relative[1], s * across[1]), (0.0, s)])
        return measured, by_pose, by_bias

    def _gauss_newton_step(self) -> float:
        """Take one step of Gauss and Newton; return the largest change of a pose."""
        builder = self._linearized()
        matrix, gradient = builder.matrix(), builder.gradient
        change = splu(matrix).solve(-gradient).reshape(-1, STATES)
        count = len(self._states)
        self._states += change[:count]
        self.bias += change[count, : len(self.bias)]
        self.mean_drift += change[count + 1 :, 3:]
        self._states[:, 2] = wrapped(self._states[:, 2])
        return float(np.abs(change[:count, :3]).max())

    def _linearized(self) -> "_NormalEquations":
        # Behind the nodes come one with the common errors of the registrations, and one with the
        # mean drift of each dive. Their other states do nothing.
        bias_node = len(self._states)
        normal = _NormalEquations(bias_node + 1 + len(self.mean_drift))
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
        for k, step in enumerate(self.steps):
            dive = int(self._dive_of[k])
            mean_node = bias_node + 1 + dive
            from_mean = self._states[k, 3:] - self.mean_drift[dive]
            if step is None:
                normal.add([k, mean_node], [drift, -drift], from_mean, np.diag(spread**-2.0))
                continue
            keep = math.exp(-step.seconds / self.model.memory_s)
            residual = from_mean - keep * (self._states[k - 1, 3:] - self.mean_drift[dive])
            variance = spread**2 * max(1 - keep**2, 1e-6)
            of_drift = [-keep * drift, drift, (keep - 1) * drift]
            normal.add([k - 1, k, mean_node], of_drift, residual, np.diag(1 / variance))
            jacobians, residual, information = self._step_factor(k, step)
            normal.add([k - 1, k], jacobians, residual, self._step_weights[k] * information)
        for loop in self.loops:
            (of_i, of_j), relative = self._relative(loop.i, loop.j, np.zeros(3))
            measured, by_pose, by_bias = self.measured_by(loop, relative)
            residual = measured - loop.poses[loop.chosen]
            residual[2] = math.remainder(residual[2], math.tau)
            information = loop.weight * loop.information[loop.chosen]
            jacobians = [by_pose @ of_i, by_pose @ of_j, by_bias @ of_bias]
            normal.add([loop.i, loop.j, bias_node], jacobians, residual, information)
        for fix in self.fixes:
            residual = self._states[fix.node, :2] - fix.position_m
            information = fix.weight / fix.deviation_m**2 * np.eye(2)
            normal.add([fix.node], [np.eye(2, STATES)], residual, information)
        return normal

    def _step_factor(self, k: int, step: OdometryStep) -> tuple[list[Floats], Floats, Floats]:
        """Jacobians by the states of the nodes k - 1 and k, residual and information of a step."""
        scale, crab, turn = self._states[k - 1, 3:]
        angle = crab + turn * step.seconds / 2
        c, s = math.cos(angle), math.sin(angle)
        x, y, yaw = step.motion
        turned = np.array([c * x - s * y, s * x + c * y])
        across = np.array([-turned[1], turned[0]])
        drifted = np.append((1 + scale) * turned, yaw + turn * step.seconds)
        jacobians, residual = self._relative(k - 1, k, drifted)
        jacobians[0][:2, 3] -= turned
        jacobians[0][:2, 4] -= (1 + scale) * across
        jacobians[0][:2, 5] -= (1 + scale) * across * step.seconds / 2
        jacobians[0][2, 5] -= step.seconds
        model = self.model
        variance_m2 = model.noise_m**2 * max(step.path_m, 0.1) + 0.01**2 + step.extra_std_m**2
        variance_rad2 = model.noise_rad**2 * step.seconds + 1e-6 + step.extra_std_rad**2
        return jacobians, residual, np.diag([1 / variance_m2, 1 / variance_m2, 1 / variance_rad2])

    def _relative(self, i: int, j: int, measured: Floats) -> tuple[list[Floats], Floats]:
        """Jacobians of i_T_j less a measurement by the states of i and j, and the residual."""
        a, b = self._states[i, :3], self._states[j, :3]
        c, s = math.cos(a[2]), math.sin(a[2])
        dx, dy = b[:2] - a[:2]
        x, y = c * dx + s * dy, -s * dx + c * dy
        residual = np.array([x, y, b[2] - a[2]]) - measured
        residual[2] = math.remainder(residual[2], math.tau)
        of_i, of_j = np.zeros((3, STATES)), np.zeros((3, STATES))
        of_i[:, :3] = np.array([(-c, -s, y), (s, -c, -x), (0.0, 0.0, -1.0)])
        of_j[:, :3] = np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)])
        return [of_i, of_j], residual

    def covariance_of(self, i: int, others: Sequence[int]) -> Floats:
        """Return the covariances (M, 3, 3) of i_T_j for some nodes j, without the loops' outliers.

        `prepare_covariances` must have been called since the last change.
        """
        joint = self._columns(i)
        own = joint[i]
        found = np.empty((len(others), 3, 3))
        for row, j in enumerate(others):
            jacobians, _ = self._relative(i, j, np.zeros(3))
            a, b = jacobians[0][:, :3], jacobians[1][:, :3]
            cross = joint[j]  # covariance of j with i
            found[row] = (
                a @ own @ a.T + a @ cross.T @ b.T + b @ cross @ a.T + b @ self._marginals[j] @ b.T
            )
        return found

    def prepare_covariances(self) -> Floats:
        """Factorize the present graph; return the covariance (N, 3, 3) of every node's pose."""
        count = len(self._states)
        self._factor = splu(self._linearized().matrix())
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
        places = np.concatenate([np.arange(n * STATES, (n + 1) * STATES) for n in nodes])
        jacobian = np.hstack(jacobians)
        weighted = jacobian.T @ information
        self.gradient[places] += weighted @ residual
        self.squared += float(residual @ information @ residual)
        self._rows.append(np.repeat(places, len(places)))
        self._columns.append(np.tile(places, len(places)))
        self._values.append((weighted @ jacobian).ravel())

    def matrix(self) -> csc_array:
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        values = np.concatenate(self._values)
        shape = (self.size, self.size)
        return coo_array((values, (rows, columns)), shape=shape).tocsc()
