"""Deciding for pings in a row: what lies near one another in pose and time is decided as one.

Looking and asking all rules costs more than a ping can spare, and their answers hardly change from
one ping to the next. So poses, times and velocities are rounded before they are looked from, and
what came out is kept for the next ping of the same cell. A decision thus depends on the ping alone,
never on which pings went before: that would make the bytes depend on who computes which ping.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sonar_sim.effects.look import Look
from sonar_sim.effects.movers import doppler_shift_s
from sonar_sim.effects.plan import Decision, EffectPlan, Wish
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.effects.view import View
from sonar_sim.engine import SonarMotion
from sonar_sim.physics import Physics
from sonar_sim.poses import Pose
from sonar_sim.tolerance import Tolerance

CELLS_IN_RANGE = 64
"""Cells of position in the sonar's range."""
ANGLE_RAD = math.radians(1.0)
"""Steps of the rotation vector, which has no direction in which it turns about wildly."""
TIME_S = 0.5
"""How long moving objects are taken to stand."""
MOVED_CELLS = 0.2
"""Steps of velocity and turn rate, by how far they move an echo at full range."""
KEPT = 8
"""Views at a time; each holds a few MB."""
OWN_TIME = "interference"
"""The effect that each ping decides anew: when another sonar is heard."""


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What was decided for one ping.

    Attributes:
        plan: every effect's verdict.
        physics: the settings of those that are on; the caller's own.
        view: what the rules saw.
    """

    plan: EffectPlan
    physics: Physics
    view: View


@dataclass(frozen=True, slots=True)
class _Cell:
    """Rounded pose, time and motion: what pings decided as one have in common."""

    position: tuple[int, ...]
    turned: tuple[int, ...]
    time: int
    velocity: tuple[int, ...] | None
    turn: tuple[int, ...] | None


class Planner:
    """Decides for pings; may be asked from several threads at once.

    Args:
        look: at the scene.
        wish: what is asked for.
        tolerance: by which the rules decide.
    """

    def __init__(self, look: Look, wish: Wish, tolerance: Tolerance) -> None:
        self._look = look
        self._wish = wish
        self._tolerance = tolerance
        self._step_m = look.sonar.range_m / CELLS_IN_RANGE
        self._step_mps, self._step_rps = _steps_of_motion(look)
        self._known: OrderedDict[_Cell, Planned] = OrderedDict()
        self._lock = Lock()

    def at(
        self,
        map_T_sonar: Pose,  # noqa: N803 frames in the name
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> Planned:
        """Decide for one ping."""
        cell = self._cell(map_T_sonar, time_s, motion)
        with self._lock:
            known = self._known.get(cell)
        if known is None:
            known = self._decided(cell)
            with self._lock:
                self._known[cell] = known
                while len(self._known) > KEPT:
                    self._known.popitem(last=False)
        middle = known.view.map_T_sonar.position_m
        if not self._look.clear(map_T_sonar.position_m, middle, time_s):
            # The cell's middle lies behind a wall.
            return self._planned(self._look.at(map_T_sonar, ping_id, time_s, motion))
        if not self._look.scene.emitters:
            return replace(known, physics=replace(known.physics))
        own = replace(known.view, map_T_sonar=map_T_sonar, ping_id=ping_id, time_s=time_s)
        return self._with_own_time(known, own)

    def _decided(self, cell: _Cell) -> Planned:
        motion = None
        turned = Rotation.from_rotvec(np.array(cell.turned) * ANGLE_RAD)
        pose = Pose(np.array(cell.position) * self._step_m, turned.as_matrix())
        if cell.velocity is not None and cell.turn is not None:
            velocity_mps = np.array(cell.velocity) * self._step_mps
            motion = SonarMotion(pose.rotation @ velocity_mps, np.array(cell.turn) * self._step_rps)
        return self._planned(self._look.at(pose, 0, cell.time * TIME_S, motion))

    def _planned(self, view: View) -> Planned:
        plan = EffectPlan.make(view, self._wish, self._tolerance)
        return Planned(plan, plan.physics(view), view)

    def _with_own_time(self, known: Planned, own: View) -> Planned:
        """The same but for what other sonars send just now."""
        effect = EFFECTS[OWN_TIME]
        verdict = effect.decide(own, self._tolerance)
        decision = Decision(effect, verdict, self._wish.on(effect.name, verdict))
        decisions = (decision if d.effect is effect else d for d in known.plan.decisions)
        physics = replace(known.physics, arrivals=())
        if decision.on:
            effect.configure(physics, own)
        return Planned(replace(known.plan, decisions=tuple(decisions)), physics, own)

    def _cell(self, pose: Pose, time_s: float, motion: SonarMotion | None) -> _Cell:
        velocity = turn = None
        if motion is not None:
            velocity = _rounded(pose.rotation.T @ motion.linear_mps, self._step_mps)
            turn = _rounded(motion.angular_rps, self._step_rps)
        return _Cell(
            position=_rounded(pose.position_m, self._step_m),
            turned=_rounded(Rotation.from_matrix(pose.rotation).as_rotvec(), ANGLE_RAD),
            time=round(time_s / TIME_S) if self._look.changes else 0,
            velocity=velocity,
            turn=turn,
        )


def _steps_of_motion(look: Look) -> tuple[float, float]:
    """Steps of velocity and turn rate that move no echo by more than `MOVED_CELLS`."""
    sonar, speed_mps = look.sonar, look.scene.water.speed_of_sound_mps
    shift_s = max(sonar.range_m / speed_mps, doppler_shift_s(sonar, speed_mps))
    turned_s = 2.0 * sonar.range_m / speed_mps
    step_mps = MOVED_CELLS * sonar.range_resolution_m / shift_s
    return step_mps, MOVED_CELLS * sonar.beam_width_rad / turned_s


def _rounded(values: NDArray[np.float64], step: float) -> tuple[int, ...]:
    return tuple(np.rint(np.asarray(values, dtype=np.float64) / step).astype(int).tolist())
