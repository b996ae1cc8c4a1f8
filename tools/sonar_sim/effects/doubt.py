"""How sure the rules are of what they say from near a ping's own pose.

From the middle of a cell of poses a ping is seen a little brighter or dimmer than it is, and most
changes show or not by a step of the quantiser. So a rule is asked for a brighter ping, and for a
dimmer one where that calls for its effect. If both say the same it is sure; else it is left to the
ping itself.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

from sonar_sim.effects.plan import AUTO, Decision, EffectPlan, Wish
from sonar_sim.effects.preview import View
from sonar_sim.tolerance import Tolerance

MARGIN_DB = 1.5
"""How much brighter or dimmer a ping may be than its cell's middle."""
OFF, ON = 0.5, 2.0
"""Parts of the tolerated level: below the one and above the other a predicted change is clear."""
CLEAR_DB = 6.0
"""More is no matter of a step."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What the rules say of a cell.

    Attributes:
        plan: every effect's verdict.
        doubtful: effects that each of the cell's pings must be asked for itself.
    """

    plan: EffectPlan
    doubtful: frozenset[str]


def judged(view: View, wish: Wish, tolerance: Tolerance, names: Collection[str]) -> Judged:
    """Ask the rules of some effects, and how sure they are."""
    bright = replace(tolerance, brighter_db=MARGIN_DB)
    plan = EffectPlan.make(view, wish, bright, names)
    if wish.ground != AUTO:
        return Judged(plan, frozenset())
    asked = [d for d in plan.decisions if d.effect.name not in wish.forced]
    doubtful = [d.effect.name for d in asked if _doubtful(d, view, tolerance)]
    return Judged(plan, frozenset(doubtful))


def _doubtful(decision: Decision, view: View, tolerance: Tolerance) -> bool:
    predicted_db = decision.verdict.predicted_db
    if predicted_db <= OFF * tolerance.level_db or predicted_db > CLEAR_DB:
        return False
    dim = replace(tolerance, brighter_db=-MARGIN_DB)
    dimmer = decision.effect.decide(view, dim)
    return not dimmer.on or dimmer.predicted_db <= ON * tolerance.level_db
