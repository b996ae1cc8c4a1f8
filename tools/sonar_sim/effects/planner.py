"""Choose the effects of each ping in a sequence.

Previews and rules cost more than one ping can spare, and their results change little between pings.
So poses and times are rounded to cells, and the results of a cell are reused. Motion and other
sonars are evaluated for every ping. A decision depends on the ping alone, never on earlier pings:
otherwise the bytes would depend on which process computes a ping.

A ping may be brighter or dimmer than its cell's centre shows. So the rules assume a brighter ping,
and an effect is computed from half of the tolerated change on. Effects that cost less than a
decision are decided by bounds: a thin object's few pixels do not call for them, and are right only
with them. A cloud is computed if any ping of the cell may have it in its fan.
"""

import math
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import Lock
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sonar_sim.effects.directivity import (
    ALL_ELEVATIONS,
    elevations_that_show,
    within_elevations,
)
from sonar_sim.effects.displacement import DISPLACING_EFFECTS
from sonar_sim.effects.effect import RuleResult
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.multipath import MULTIPATH
from sonar_sim.effects.plan import AUTO, Decision, EffectPlan, EffectSelection
from sonar_sim.effects.preview import PingInstance, PingPreview, PoseSlack
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.effects.scattering import BOTTOM_REVERBERATION, SPECULAR
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.fan import MAX_ELEVATION_RAD
from sonar_sim.scene.scene import Bubbles, Sediment

MARGIN_DB = 1.5
"""How much brighter or dimmer a ping may be than its cell's middle."""
DOUBT = 0.5
"""An effect is computed from this fraction of the tolerated level on."""


@dataclass(frozen=True, slots=True)
class _Bound:
    """A decision that needs no picture: whether an effect that costs little can show."""

    may_show: Callable[[PingPreview, Tolerance], bool]
    reason: str


_BOUNDS = {
    "spreading": _Bound(lambda _view, _tolerance: True, "echoes have ranges"),
    "absorption": _Bound(
        lambda view, tolerance: 2.0 * view.water_db_per_m * view.sonar.range_m > tolerance.level_db,
        "2 alpha R at the last row",
    ),
    "vertical_pattern": _Bound(lambda _view, _tolerance: True, "rays leave the fan's plane"),
    "shadows": _Bound(lambda view, _tolerance: bool(view.scene.surfaces), "surfaces hide others"),
    "lambert": _Bound(lambda view, _tolerance: bool(view.scene.surfaces), "surfaces have slopes"),
    "saturation": _Bound(lambda _view, _tolerance: True, "pixels have a greatest value"),
    "side_lobes": _Bound(lambda _view, _tolerance: True, "echoes have arcs"),
    "tvg": _Bound(lambda _view, _tolerance: True, "echoes have ranges"),
    "gain": _Bound(lambda view, _tolerance: view.gains.operator_db != 0.0, "it is not 0 dB"),
    "quantisation": _Bound(lambda _view, _tolerance: True, "an Oculus sends integers"),
    "reverberation": _Bound(
        lambda view, _tolerance: len(view.echoes.range_m) > 0, "echoes leave a tail"
    ),
}

BY_BOUNDS = frozenset(_BOUNDS)
"""Effects that cost less than a decision. That of a tail also depends on ghosts of ghosts, which a
preview lacks."""


def decide_cell(
    view: PingPreview, selection: EffectSelection, tolerance: Tolerance, names: Collection[str]
) -> EffectPlan:
    """Decide on some effects for a cell of poses, in doubt for them."""
    bright = replace(tolerance, brighter_db=MARGIN_DB)
    if selection.ground != AUTO:
        return EffectPlan.make(view, selection, bright, names)
    plan = EffectPlan.make(view, selection, bright, frozenset(names) - frozenset(_BOUNDS))
    decisions = [_in_doubt_on(decision, view, selection, tolerance) for decision in plan.decisions]
    decisions = _with_mirrored_floor(decisions, view, selection)
    if not any(d.on and d.effect.name == SPECULAR.name for d in decisions):
        decisions = [_within_limits(decision, view, selection, bright) for decision in decisions]
    for name, bound in _BOUNDS.items():
        if name in names:
            on = bound.may_show(view, tolerance)
            verdict = RuleResult(on, f"costs little; {bound.reason}", math.inf)
            decisions.append(Decision(EFFECTS[name], verdict, selection.on(name, verdict)))
    return EffectPlan((), auto=True).with_more(EffectPlan(tuple(decisions), auto=True))


def _in_doubt_on(
    decision: Decision, view: PingPreview, selection: EffectSelection, tolerance: Tolerance
) -> Decision:
    verdict, name = decision.verdict, decision.effect.name
    cloudy = name in CLOUD_EFFECTS and _clouds_in_fan(view, CLOUD_EFFECTS[name])
    if verdict.on or not (cloudy or verdict.predicted_db > DOUBT * tolerance.level_db):
        return decision
    doubt = replace(verdict, on=True, reason=f"{verdict.reason}; in doubt")
    return Decision(decision.effect, doubt, selection.on(name, doubt))


def _with_mirrored_floor(
    decisions: list[Decision], view: PingPreview, selection: EffectSelection
) -> list[Decision]:
    """Let the floor echo where mirrors are: the coarse rays do not look into them."""
    if not view.bottoms or not any(d.on and d.effect.name == MULTIPATH.name for d in decisions):
        return decisions

    def decide(decision: Decision) -> Decision:
        name, verdict = decision.effect.name, decision.verdict
        if name != BOTTOM_REVERBERATION.name or verdict.on:
            return decision
        doubt = replace(verdict, on=True, reason=f"{verdict.reason}; mirrors may show it")
        return Decision(decision.effect, doubt, selection.on(name, doubt))

    return [decide(decision) for decision in decisions]


def _within_limits(
    decision: Decision, view: PingPreview, selection: EffectSelection, tolerance: Tolerance
) -> Decision:
    """Let rays end at the elevations beyond which nothing shows, unless a user wants them all."""
    name, verdict = decision.effect.name, decision.verdict
    if name != ALL_ELEVATIONS.name or not decision.on or name in selection.forced:
        return decision
    half_step_m = 0.5 * view.sonar.range_m / CELLS_IN_RANGE[0]
    slack = PoseSlack(math.sqrt(3.0) * half_step_m, TURN_SLACK_RAD)
    limits_rad = elevations_that_show(view, tolerance, DOUBT * tolerance.level_db, slack)
    low_deg, high_deg = (round(math.degrees(limit)) for limit in limits_rad)
    reason = f"{verdict.reason}; rays from {low_deg}° to {high_deg}°"
    narrower = within_elevations(decision.effect, limits_rad)
    return Decision(narrower, replace(verdict, reason=reason), decision.on)


def _clouds_in_fan(view: PingPreview, kind: type[Bubbles] | type[Sediment]) -> bool:
    """Whether a ping near the view's pose may have a cloud of a kind in its fan."""
    slack_m = view.sonar.range_m / CELLS_IN_RANGE[0]
    for cloud in view.clouds_of(kind):
        low_m, high_m = np.array(cloud.spec.low_m), np.array(cloud.spec.high_m)
        away_m = ((low_m + high_m) / 2.0 - view.map_T_sonar.position_m) @ view.map_T_sonar.rotation
        range_m = float(np.linalg.norm(away_m))
        reach_m = float(np.linalg.norm(high_m - low_m)) / 2.0 + slack_m
        if range_m <= reach_m:
            return True
        slack_rad = math.asin(reach_m / range_m) + ANGLE_STEP_RAD
        bearing_rad = abs(math.atan2(away_m[1], away_m[0]))
        up_rad = abs(math.asin(away_m[2] / range_m))
        if (
            range_m < view.sonar.range_m + reach_m
            and bearing_rad < view.sonar.half_aperture_rad + slack_rad
            and up_rad < MAX_ELEVATION_RAD + slack_rad
        ):
            return True
    return False


CELLS_IN_RANGE = (16, 48)
"""Cells of position in the sonar's range; the finer ones where the larger one's middle lies behind
a wall."""
ANGLE_STEP_RAD = math.radians(6.0)
"""Steps of the heading, and of the components of the vertical in the sonar's axes. A vehicle that
turns crosses cells of heading alone, wherever its sonar looks."""
HEADINGS = round(math.tau / ANGLE_STEP_RAD)
TURN_SLACK_RAD = ANGLE_STEP_RAD
"""How far a ping may be turned from its cell's middle: by half a step of heading, and by half the
diagonal of a cube about an axis at right angles to that."""
TIME_STEP_S = 0.5
"""How long moving objects are taken to stand."""
MAX_PREVIEWS = 8
"""Views at a time; each holds a few MB."""
PER_PING = frozenset({*DISPLACING_EFFECTS, "interference"})
"""Effects that are decided for each ping: by its motion, and by other sonars in range."""
CLOUD_EFFECTS: Mapping[str, type[Bubbles] | type[Sediment]] = MappingProxyType(
    {"bubbles": Bubbles, "turbidity": Sediment}
)
SHARED = frozenset(EFFECTS) - PER_PING


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
class _PoseCell:
    """Rounded pose and time: what pings looked at as one have in common.

    Attributes:
        position: of the sonar, in steps of `step_m`.
        step_m: edge of the cell.
        up: components of the vertical in the sonar's axes, in steps of `ANGLE_STEP_RAD`.
        heading: likewise; counted from `_tilt` of the vertical.
        time: in steps of `TIME_STEP_S`; 0 where nothing moves.
    """

    position: tuple[int, ...]
    step_m: float
    up: tuple[int, ...]
    heading: int
    time: int

    @property
    def middle_m(self) -> NDArray[np.float64]:
        """Map frame, (3,)."""
        return np.array(self.position) * self.step_m

    @property
    def pose(self) -> FramePose:
        """Pose from which all its pings are seen."""
        turn = Rotation.from_rotvec([0.0, 0.0, self.heading * ANGLE_STEP_RAD]).as_matrix()
        return FramePose(self.middle_m, turn @ _tilt(self.up))


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """What a cell's pings have in common.

    Attributes:
        plan: of what does not depend on motion.
        physics: the settings of the plan.
        view: from the cell's middle.
    """

    plan: EffectPlan
    physics: Physics
    view: PingPreview


class Planner:
    """Decides for pings; may be asked from several threads at once.

    Args:
        previewer: of the scene.
        selection: of effects.
        tolerance: by which the rules decide.
    """

    def __init__(
        self, previewer: Previewer, selection: EffectSelection, tolerance: Tolerance
    ) -> None:
        self._previewer = previewer
        self._selection = selection
        self._tolerance = tolerance
        self._cache: OrderedDict[_PoseCell, _Shared] = OrderedDict()
        self._lock = Lock()

    def at(
        self,
        map_T_sonar: FramePose,  # noqa: N803 frames in the name
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> PlannedPing:
        """Decide for one ping."""
        ping = PingInstance(map_T_sonar, ping_id, time_s, motion)
        cell = self._cell_near(map_T_sonar, time_s)
        if cell is not None:
            return self._for_ping(self._shared_of(cell), ping)
        view = self._previewer.at(map_T_sonar, ping_id, time_s)
        return self._for_ping(self._decide_shared(view), ping)

    def _cell_near(self, map_T_sonar: FramePose, time_s: float) -> _PoseCell | None:  # noqa: N803
        """The ping's cell, unless its middle is behind a wall."""
        for parts in CELLS_IN_RANGE:
            cell = self._cell(map_T_sonar, time_s, self._previewer.sonar.range_m / parts)
            if self._previewer.clear(map_T_sonar.position_m, cell.middle_m, time_s):
                return cell
        return None

    def _shared_of(self, cell: _PoseCell) -> _Shared:
        with self._lock:
            shared = self._cache.get(cell)
        if shared is None:
            slack_m = math.sqrt(3.0) * 0.5 * cell.step_m
            time_s = cell.time * TIME_STEP_S
            view = self._previewer.at(cell.pose, 0, time_s, slack_m=slack_m)
            shared = self._decide_shared(view)
            with self._lock:
                self._cache[cell] = shared
                while len(self._cache) > MAX_PREVIEWS:
                    self._cache.popitem(last=False)
        return shared

    def _decide_shared(self, view: PingPreview) -> _Shared:
        """What does not depend on motion."""
        plan = decide_cell(view, self._selection, self._tolerance, SHARED)
        return _Shared(plan, plan.physics(view), view)

    def _for_ping(self, shared: _Shared, ping: PingInstance) -> PlannedPing:
        """Add the effects that are decided for each ping."""
        view = shared.view.for_ping(ping)
        own = EffectPlan.make(view, self._selection, self._tolerance, PER_PING)
        physics = replace(shared.physics)
        own.configure(physics, view)
        return PlannedPing(shared.plan.with_more(own), physics, view)

    def _cell(self, pose: FramePose, time_s: float, step_m: float) -> _PoseCell:
        up = _rounded(pose.rotation[2], ANGLE_STEP_RAD)
        turned = pose.rotation @ _tilt(up).T
        heading_rad = math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
        return _PoseCell(
            position=_rounded(pose.position_m, step_m),
            step_m=step_m,
            up=up,
            heading=round(heading_rad / ANGLE_STEP_RAD) % HEADINGS,
            time=round(time_s / TIME_STEP_S) if self._previewer.changes else 0,
        )


@lru_cache(maxsize=256)
def _tilt(up: tuple[int, ...]) -> NDArray[np.float64]:
    """A rotation (3, 3) whose vertical is that of a cell, by its rounded components."""
    vertical = np.array(up) / np.linalg.norm(up)
    ahead = np.eye(3)[np.abs(up).argmin()]
    ahead = ahead - (ahead @ vertical) * vertical
    ahead = ahead / np.linalg.norm(ahead)
    tilt = np.array([ahead, np.cross(vertical, ahead), vertical])
    tilt.setflags(write=False)
    return tilt


def _rounded(values: NDArray[np.float64], step: float) -> tuple[int, ...]:
    return tuple(np.rint(np.asarray(values, dtype=np.float64) / step).astype(int).tolist())
