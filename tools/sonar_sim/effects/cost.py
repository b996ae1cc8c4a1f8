"""What each effect costs: pings with it against pings without it."""

import time
from dataclasses import replace
from statistics import median

from sonar_sim.effects.plan import Decision, EffectPlan
from sonar_sim.effects.preview import View
from sonar_sim.engine import Engine
from sonar_sim.propagation.physics import Physics


def measured_costs_ms(
    engine: Engine, plan: EffectPlan, view: View, repeats: int
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


def _ping_ms(engine: Engine, physics: Physics, view: View) -> float:
    start = time.process_time()
    engine.ping(view.own_pose, physics, view.ping_id, view.own_time_s, view.motion)
    return (time.process_time() - start) * 1e3
