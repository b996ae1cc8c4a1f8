"""Check the effects' rules against full simulations, and measure each effect's cost.

What the rules leave out must not show: the picture must stay within the tolerance of the one with
all effects. What they compute must be worth it: without any one of them it must not. Level is
compared between expected pictures, grain and displacement between speckled ones of the same seeds:
of several, since a picture may hold too few blocks of speckle to separate a displacement from
chance.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import median

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.displacement import DISPLACING_EFFECTS
from sonar_sim.effects.image_difference import (
    Tolerance,
    expected_clipped,
    gamma_of,
    level_change_db,
    quantiser_change_db,
)
from sonar_sim.effects.plan import Decision, EffectPlan, EffectSelection
from sonar_sim.effects.planner import BY_BOUNDS, MARGIN_DB, Planner
from sonar_sim.effects.preview import PingPreview
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.effects.texture import (
    SpeckleTexture,
    displacement_cells,
    merged_texture,
    speckle_texture,
    texture_change,
)
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose

SEEDS = (0, 1, 2)


@dataclass(frozen=True, slots=True)
class PictureDifference:
    """How much two pictures differ; see `Tolerance` for the three.

    Attributes:
        level_db: of the expected level.
        cells: of displacement; None if no part of the picture is found in the other.
        texture: of the speckle.
    """

    level_db: float
    cells: float | None
    texture: float

    def within(self, tolerance: Tolerance) -> bool:
        """Whether none of them exceeds its tolerance."""
        return (
            self.level_db <= tolerance.level_db
            and (self.cells is None or self.cells <= tolerance.cells)
            and self.texture <= tolerance.texture
        )


@dataclass(frozen=True, slots=True)
class RuleCheck:
    """One ping's rules, checked.

    Attributes:
        plan: what the rules chose.
        left_out: from what they chose to everything.
        without: from what they chose to the same without one effect, for each that is on; where
            the level already exceeds its tolerance, cells and texture stay 0.
        tolerance: by which they decided.
        excused: effects that need not show: those in doubt, which this ping or a dimmer one would
            not call for, and those that cost next to nothing.
    """

    plan: EffectPlan
    left_out: PictureDifference
    without: Mapping[str, PictureDifference]
    tolerance: Tolerance
    excused: frozenset[str] = frozenset()

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong, a line each."""
        wrong = [] if self.left_out.within(self.tolerance) else [f"left out: {self.left_out}"]
        idle = [
            f"{n}: {c}"
            for n, c in self.without.items()
            if c.within(self.tolerance) and n not in self.excused and not _is_hidden(n, c)
        ]
        return (*wrong, *idle)


def _is_hidden(name: str, change: PictureDifference) -> bool:
    """Whether an effect that moves the picture does so where no part of it can be followed."""
    return name in DISPLACING_EFFECTS and change.cells is None


@dataclass(frozen=True, eq=False)
class RenderedPing:
    """One ping both ways.

    Attributes:
        expected: amplitude of full scale without speckle, (rows, beams).
        look_closer: makes the grain.
    """

    expected: NDArray[np.float32]
    look_closer: Callable[[], SpeckleTexture]

    @cached_property
    def grain(self) -> SpeckleTexture:
        """Of the speckled pictures of surfaces, without noise."""
        return self.look_closer()


class RuleChecker:
    """Checks the rules on a scenario's pings.

    Args:
        scenario: whose scene and sonar.
        tolerance: by which the rules decide, and which must be kept.
        seeds: of the speckled pictures.
    """

    def __init__(
        self,
        scenario: Scenario,
        tolerance: Tolerance | None = None,
        seeds: Sequence[int] = SEEDS,
    ) -> None:
        self._scenario = scenario
        self._tolerance = tolerance or Tolerance()
        self._engines = [PingEngine(scenario.scene, scenario.sonar, seed) for seed in seeds]
        self._previewer = Previewer(scenario.scene, scenario.sonar, self._engines[0].meshes)
        self._planner = Planner(self._previewer, EffectSelection.read("auto"), self._tolerance)

    def check(self, time_s: float) -> RuleCheck:
        """Check them at a time of the trajectory."""
        pose, motion = sonar_pose(self._scenario, time_s), sonar_motion(self._scenario, time_s)
        planned = self._planner.at(pose, 0, time_s, motion)
        plan, view = planned.plan, planned.view
        chosen = self._pictures(planned.physics, view)
        all_on = EffectPlan.make(view, EffectSelection.read("all"), self._tolerance)
        everything = self._pictures(all_on.physics(view), view)
        left_out = self._change(chosen, everything, self._tolerance.share, ignore_dark_shift=True)
        without = {name: self._change_without(name, chosen, plan, view) for name in plan.names}
        own = self._previewer.at(pose, 0, time_s, motion)
        return RuleCheck(plan, left_out, without, self._tolerance, self._excused(plan, own))

    def _excused(self, plan: EffectPlan, view: PingPreview) -> frozenset[str]:
        """Effects that this ping's own preview does not call for, or would not 1.5 dB dimmer."""
        levels = (self._tolerance, replace(self._tolerance, brighter_db=-MARGIN_DB))
        doubtful = (
            d.effect.name
            for d in plan.decisions
            if not all(d.effect.decide(view, level).on for level in levels)
        )
        return frozenset(doubtful) | BY_BOUNDS

    def _change_without(
        self, name: str, everything: RenderedPing, plan: EffectPlan, view: PingPreview
    ) -> PictureDifference:
        if name == "quantisation":
            shown = np.minimum(everything.expected, 1.0)
            change_db = quantiser_change_db(shown, self._scenario.sonar, self._tolerance.share)
            return PictureDifference(change_db, 0.0, 0.0)
        share = 0.0 if EFFECTS[name].anywhere else self._tolerance.share
        other = self._pictures(plan.switched_off(name).physics(view), view)
        # The rules take a ping to be as bright as any of its cell.
        bright = 10.0 ** (MARGIN_DB / 20.0)
        level_db = max(self._level_db(everything, other, share, by) for by in (1.0, bright))
        if level_db > self._tolerance.level_db:
            # That is enough: grain takes four more pictures.
            return PictureDifference(level_db, 0.0, 0.0)
        return self._change(everything, other, share)

    def _change(
        self,
        first: RenderedPing,
        second: RenderedPing,
        share: float,
        *,
        ignore_dark_shift: bool = False,
    ) -> PictureDifference:
        return PictureDifference(
            self._level_db(first, second, share, ignore_dark_shift=ignore_dark_shift),
            displacement_cells(first.grain, second.grain),
            texture_change(first.grain, second.grain),
        )

    def _level_db(
        self,
        first: RenderedPing,
        second: RenderedPing,
        share: float,
        brighter: float = 1.0,
        *,
        ignore_dark_shift: bool = False,
    ) -> float:
        cells = self._tolerance.cells
        one, other = (np.float32(brighter) * ping.expected for ping in (first, second))
        return level_change_db(
            one,
            other,
            self._scenario.sonar,
            share,
            (cells, cells),
            ignore_dark_shift=ignore_dark_shift,
        )

    def _pictures(self, physics: Physics, view: PingPreview) -> RenderedPing:
        physics = replace(physics, quantised=False)
        expected = self._shown(replace(physics, speckle=False, saturation=False), view)
        if physics.saturation:
            expected = expected_clipped(expected)
        return RenderedPing(expected, lambda: self._grain(physics, view))

    def _grain(self, physics: Physics, view: PingPreview) -> SpeckleTexture:
        # What is no surface does not move with them.
        still = replace(
            physics,
            noise_level_db=None,
            volume_strength_db=None,
            reverberation=None,
            ring_down_db=None,
        )
        surfaces = self._shown(replace(still, speckle=False), view)
        sonar, engines = self._scenario.sonar, self._engines
        grains = [
            speckle_texture(self._shown(still, view, engine), surfaces, sonar) for engine in engines
        ]
        return merged_texture(grains)

    def _shown(
        self, physics: Physics, view: PingPreview, engine: PingEngine | None = None
    ) -> NDArray[np.float32]:
        """Amplitude of full scale, with the sonar's gamma undone."""
        made = (engine or self._engines[0]).ping(
            view.own_pose, physics, 0, view.own_time_s, view.motion
        )
        shown: NDArray[np.float32] = np.asarray(made.image, dtype=np.float32)
        return shown ** np.float32(1.0 / gamma_of(self._scenario.sonar))


def measured_costs_ms(
    engine: PingEngine, plan: EffectPlan, view: PingPreview, repeats: int
) -> dict[str, float]:
    """CPU time of all threads that each effect adds to the plan's ping, or would add, by name, ms.

    With and without are measured in turn, and the median of the differences is taken; what costs
    next to nothing can come out a little below zero.
    """
    chosen = plan.physics(view)
    _ping_ms(engine, chosen, view)
    costs = {}
    for decision in plan.decisions:
        other = _toggled(plan, decision).physics(view)
        differences = [
            _ping_ms(engine, chosen, view) - _ping_ms(engine, other, view) for _ in range(repeats)
        ]
        costs[decision.effect.name] = median(differences) * (1.0 if decision.on else -1.0)
    return costs


def _toggled(plan: EffectPlan, toggled: Decision) -> EffectPlan:
    decisions = tuple(
        Decision(d.effect, d.verdict, not d.on) if d is toggled else d for d in plan.decisions
    )
    return replace(plan, decisions=decisions)


def _ping_ms(engine: PingEngine, physics: Physics, view: PingPreview) -> float:
    start = time.process_time()
    engine.ping(view.own_pose, physics, view.ping_id, view.own_time_s, view.motion)
    return (time.process_time() - start) * 1e3
