"""Choose the effects of each ping in a sequence.

Looking and asking all rules costs more than a ping can spare, and their answers hardly change from
one ping to the next. So poses and times are rounded before they are looked from, and what came out
is kept for the next ping of the same cell. Where a rule is in doubt about a cell, each of its pings
looks from its own pose. What motion displaces and what other sonars send is
asked of every ping, by its own motion and time. A decision thus depends on the ping alone, never on
which pings went before: that would make the bytes depend on who computes which ping.

How certain a rule's result is when it is taken from near a ping's own pose.

From the middle of a cell of poses a ping is seen a little brighter or dimmer than it is, and most
changes show or not by a step of the quantiser. So a rule is asked for a brighter ping, and for a
dimmer one where that calls for its effect. Equal results are certain; else the rule is left to the
ping itself.
"""

import math
from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sonar_sim.effects.displacement import DISPLACING_EFFECTS
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import AUTO, Decision, EffectPlan, EffectSelection
from sonar_sim.effects.preview import PingInstance, PingPreview
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.physics import Physics

MARGIN_DB = 1.5
"""How much brighter or dimmer a ping may be than its cell's middle."""
OFF, ON = 0.5, 2.0
"""Parts of the tolerated level: below the one and above the other a predicted change is clear."""
CLEAR_DB = 6.0
"""More is no matter of a step."""


@dataclass(frozen=True, slots=True)
class CellDecision:
    """Results of the rules for a cell of poses.

    Attributes:
        plan: every effect's verdict.
        doubtful: effects that each of the cell's pings must be asked for itself.
    """

    plan: EffectPlan
    doubtful: frozenset[str]


def decide_cell(
    view: PingPreview, wish: EffectSelection, tolerance: Tolerance, names: Collection[str]
) -> CellDecision:
    """Ask the rules of some effects, and how sure they are."""
    bright = replace(tolerance, brighter_db=MARGIN_DB)
    plan = EffectPlan.make(view, wish, bright, names)
    if wish.ground != AUTO:
        return CellDecision(plan, frozenset())
    asked = [d for d in plan.decisions if d.effect.name not in wish.forced]
    doubtful = [d.effect.name for d in asked if _doubtful(d, view, tolerance)]
    return CellDecision(plan, frozenset(doubtful))


def _doubtful(decision: Decision, view: PingPreview, tolerance: Tolerance) -> bool:
    predicted_db = decision.verdict.predicted_db
    if predicted_db <= OFF * tolerance.level_db or predicted_db > CLEAR_DB:
        return False
    dim = replace(tolerance, brighter_db=-MARGIN_DB)
    dimmer = decision.effect.decide(view, dim)
    return not dimmer.on or dimmer.predicted_db <= ON * tolerance.level_db


CELLS_IN_RANGE = (16, 48)
"""Cells of position in the sonar's range; the finer ones where the larger one's middle lies behind
a wall."""
ANGLE_RAD = math.radians(6.0)
"""Steps of the rotation vector, which has no direction in which it turns about wildly."""
TIME_S = 0.5
"""How long moving objects are taken to stand."""
MAX_PREVIEWS = 8
"""Views at a time; each holds a few MB."""
PER_PING = frozenset({*DISPLACING_EFFECTS, "interference"})
"""Effects that are decided for each ping: by its motion, and by other sonars in range."""
CLOUD_EFFECTS = frozenset({"bubbles", "turbidity"})
"""Effects that each ping looks for itself where a cloud is in range: a plume at the edge of the
vertical pattern comes and goes by fewer degrees than a cell has."""
SHARED = frozenset(EFFECTS) - PER_PING
CAUTION_DB = 0.5
"""How much brighter than its own coarse picture a ping is taken to be: what is left out without
need shows more than what is computed without need."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPing:
    """What was decided for one ping.

    Attributes:
        plan: every effect's verdict.
        physics: the settings of those that are on; the caller's own.
        view: what the rules saw.
    """

    plan: EffectPlan
    physics: Physics
    view: PingPreview


@dataclass(frozen=True, slots=True)
class _Cell:
    """Rounded pose and time: what pings looked at as one have in common."""

    position: tuple[int, ...]
    step_m: float
    turned: tuple[int, ...]
    time: int

    @property
    def middle_m(self) -> NDArray[np.float64]:
        """Map frame, (3,)."""
        return np.array(self.position) * self.step_m

    @property
    def pose(self) -> FramePose:
        """Pose from which all its pings are seen."""
        turned = Rotation.from_rotvec(np.array(self.turned) * ANGLE_RAD)
        return FramePose(self.middle_m, turned.as_matrix())


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """What a cell's pings have in common.

    Attributes:
        plan: of what the rules are sure of.
        doubtful: what each ping looks closer at.
        physics: the settings of the plan.
        view: from the cell's middle.
        closer: view from the ping itself, if there is one already.
    """

    plan: EffectPlan
    doubtful: frozenset[str]
    physics: Physics
    view: PingPreview
    closer: PingPreview | None


class Planner:
    """Decides for pings; may be asked from several threads at once.

    Args:
        look: at the scene.
        wish: what is asked for.
        tolerance: by which the rules decide.
    """

    def __init__(self, look: Previewer, wish: EffectSelection, tolerance: Tolerance) -> None:
        self._look = look
        self._wish = wish
        self._tolerance = tolerance
        self._known: OrderedDict[_Cell, _Shared] = OrderedDict()
        self._lock = Lock()
        self._cloudy = CLOUD_EFFECTS if look.scene.clouds else frozenset()

    def at(
        self,
        map_T_sonar: FramePose,  # noqa: N803 frames in the name
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> PlannedPing:
        """Decide for one ping."""
        ping = PingInstance(map_T_sonar, ping_id, time_s, motion)
        cell = self._near(map_T_sonar, time_s)
        if cell is not None:
            return self._own(self._of(cell), ping)
        view = self._look.at(map_T_sonar, ping_id, time_s)
        return self._own(self._judged(view, view), ping)

    def _near(self, map_T_sonar: FramePose, time_s: float) -> _Cell | None:  # noqa: N803
        """The ping's cell, unless its middle is behind a wall."""
        for parts in CELLS_IN_RANGE:
            cell = self._cell(map_T_sonar, time_s, self._look.sonar.range_m / parts)
            if self._look.clear(map_T_sonar.position_m, cell.middle_m, time_s):
                return cell
        return None

    def _of(self, cell: _Cell) -> _Shared:
        with self._lock:
            shared = self._known.get(cell)
        if shared is None:
            shared = self._judged(self._look.at(cell.pose, 0, cell.time * TIME_S))
            with self._lock:
                self._known[cell] = shared
                while len(self._known) > MAX_PREVIEWS:
                    self._known.popitem(last=False)
        return shared

    def _judged(self, view: PingPreview, closer: PingPreview | None = None) -> _Shared:
        """What does not depend on motion."""
        found = decide_cell(view, self._wish, self._tolerance, SHARED - self._cloudy)
        sure = found.plan.without(found.doubtful)
        return _Shared(sure, found.doubtful, sure.physics(view), view, closer)

    def _own(self, shared: _Shared, ping: PingInstance) -> PlannedPing:
        """Add the effects that are decided for each ping."""
        view = shared.view.of_ping(ping)
        own = EffectPlan.make(view, self._wish, self._tolerance, PER_PING)
        physics = replace(shared.physics)
        own.configure(physics, view)
        closer = shared.doubtful | self._cloudy
        if closer:
            near = view
            if shared.doubtful or self._clouds_near(ping.map_T_sonar):
                near = shared.closer or self._look.at(ping.map_T_sonar, 0, ping.time_s)
            careful = replace(self._tolerance, brighter_db=CAUTION_DB)
            more = EffectPlan.make(near, self._wish, careful, closer)
            more.configure(physics, near)
            own = own.with_more(more)
        return PlannedPing(shared.plan.with_more(own), physics, view)

    def _clouds_near(self, map_T_sonar: FramePose) -> bool:  # noqa: N803
        position_m, reach_m = map_T_sonar.position_m, self._look.sonar.range_m
        clouds = self._look.scene.clouds
        nearest = (np.clip(position_m, cloud.low_m, cloud.high_m) for cloud in clouds)
        return any(np.linalg.norm(point_m - position_m) < reach_m for point_m in nearest)

    def _cell(self, pose: FramePose, time_s: float, step_m: float) -> _Cell:
        return _Cell(
            position=_rounded(pose.position_m, step_m),
            step_m=step_m,
            turned=_rounded(Rotation.from_matrix(pose.rotation).as_rotvec(), ANGLE_RAD),
            time=round(time_s / TIME_S) if self._look.changes else 0,
        )


def _rounded(values: NDArray[np.float64], step: float) -> tuple[int, ...]:
    return tuple(np.rint(np.asarray(values, dtype=np.float64) / step).astype(int).tolist())
