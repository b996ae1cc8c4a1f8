"""Are the rules right? A ping with what they chose against one with everything, and each without.

What the rules leave out must not show: the picture must stay within the tolerance of the one with
all effects. What they compute must be worth it: without any one of them it must not. Level is
compared between expected pictures, grain and displacement between speckled ones of the same seed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.look import Look
from sonar_sim.effects.plan import EffectPlan, Wish
from sonar_sim.effects.planner import Planner
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.effects.view import View
from sonar_sim.engine import Engine, SonarMotion
from sonar_sim.physics import Physics
from sonar_sim.picture_change import gamma_of, level_change_db, quantiser_change_db
from sonar_sim.poses import Pose
from sonar_sim.scenario import Scenario
from sonar_sim.sonar_motion import sonar_motion, sonar_pose
from sonar_sim.texture import Grain, displacement_cells, grain_of, texture_change
from sonar_sim.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class Change:
    """How much two pictures differ; see `Tolerance` for the three."""

    level_db: float
    cells: float
    texture: float

    def within(self, tolerance: Tolerance) -> bool:
        """Whether none of them exceeds its tolerance."""
        return (
            self.level_db <= tolerance.level_db
            and self.cells <= tolerance.cells
            and self.texture <= tolerance.texture
        )


@dataclass(frozen=True, slots=True)
class RuleCheck:
    """One ping's rules, checked.

    Attributes:
        plan: what the rules chose.
        left_out: from what they chose to everything.
        without: from everything to what they chose without one effect, for each that is on.
        tolerance: by which they decided.
    """

    plan: EffectPlan
    left_out: Change
    without: Mapping[str, Change]
    tolerance: Tolerance

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong, a line each."""
        wrong = [] if self.left_out.within(self.tolerance) else [f"left out: {self.left_out}"]
        idle = [f"{n}: {c}" for n, c in self.without.items() if c.within(self.tolerance)]
        return (*wrong, *idle)


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """One ping both ways.

    Attributes:
        expected: amplitude of full scale without speckle, (rows, beams).
        grain: of the speckled picture of surfaces, without noise.
    """

    expected: NDArray[np.float32]
    grain: Grain


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A ping of the trajectory.

    Attributes:
        view: by which it was decided.
        map_T_sonar, time_s, motion: of the ping itself.
    """

    view: View
    map_T_sonar: Pose  # noqa: N815 frames in the name
    time_s: float
    motion: SonarMotion


class RuleChecker:
    """Checks the rules on a scenario's pings."""

    def __init__(self, scenario: Scenario, tolerance: Tolerance | None = None) -> None:
        self._scenario = scenario
        self._tolerance = tolerance or Tolerance()
        self._engine = Engine(scenario.scene, scenario.sonar)
        look = Look(scenario.scene, scenario.sonar, self._engine.meshes)
        self._planner = Planner(look, Wish.read("auto"), self._tolerance)

    def check(self, time_s: float) -> RuleCheck:
        """Check them at a time of the trajectory."""
        pose, motion = sonar_pose(self._scenario, time_s), sonar_motion(self._scenario, time_s)
        planned = self._planner.at(pose, 0, time_s, motion)
        plan, shot = planned.plan, Shot(planned.view, pose, time_s, motion)
        chosen = self._pictures("auto", shot)
        everything = self._pictures("all", shot)
        left_out = self._change(chosen, everything, self._tolerance.share)
        without = {name: self._change_without(name, chosen, shot) for name in plan.names}
        return RuleCheck(plan, left_out, without, self._tolerance)

    def _change_without(self, name: str, everything: Pictures, shot: Shot) -> Change:
        if name == "quantisation":
            shown = np.minimum(everything.expected, 1.0)
            change_db = quantiser_change_db(shown, self._scenario.sonar, self._tolerance.share)
            return Change(change_db, 0.0, 0.0)
        share = 0.0 if EFFECTS[name].anywhere else self._tolerance.share
        return self._change(everything, self._pictures(f"auto,-{name}", shot), share)

    def _change(self, first: Pictures, second: Pictures, share: float) -> Change:
        sonar, cells = self._scenario.sonar, self._tolerance.cells
        return Change(
            level_change_db(first.expected, second.expected, sonar, share, (cells, cells)),
            displacement_cells(first.grain, second.grain),
            texture_change(first.grain, second.grain),
        )

    def _pictures(self, choice: str, shot: Shot) -> Pictures:
        plan = EffectPlan.make(shot.view, Wish.read(choice), self._tolerance)
        physics = plan.physics(shot.view)
        physics.quantised = False
        expected = self._shown(replace(physics, speckle=False), shot)
        # Noise does not move with the surfaces.
        still = replace(physics, noise_level_db=None, volume_strength_db=None)
        surfaces = self._shown(replace(still, speckle=False), shot)
        grain = grain_of(self._shown(still, shot), surfaces, self._scenario.sonar)
        return Pictures(expected, grain)

    def _shown(self, physics: Physics, shot: Shot) -> NDArray[np.float32]:
        """Amplitude of full scale as one reads it who knows the sonar's gamma."""
        made = self._engine.ping(shot.map_T_sonar, physics, 0, shot.time_s, shot.motion)
        shown: NDArray[np.float32] = np.asarray(made.image, dtype=np.float32)
        return shown ** np.float32(1.0 / gamma_of(self._scenario.sonar))
