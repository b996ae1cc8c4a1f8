"""Shadows: what is hit first hides what lies behind."""

from dataclasses import replace

from sonar_sim.effects.effect import Cost, Effect, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if a second cast from behind the first hits finds echoes that would show."""
    hidden = view.hidden
    if len(hidden.range_m) == 0:
        return Verdict(on=False, reason="nothing lies behind anything", predicted_db=0.0)
    pattern = vertical_two_way_power(hidden.up, view.sonar.vertical_width_rad)
    behind = view.grid.picture(hidden, hidden.section_m2 * view.travelled(hidden) * pattern)
    share = len(hidden.range_m) / len(view.echoes.range_m)
    reason = f"behind {share:.0%} of what is hit lies something else in range"
    # Without shadows a rod's far side shows behind its near one: few pixels, but the only target.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_db(view.picture + behind, anywhere), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Stop each ray at what it meets first."""
    del view
    physics.shadows = True


EFFECT = Effect(
    name="shadows",
    does="leaves dark what is behind something",
    needs="geometry",
    formula="the nearest hit of a ray ends it",
    source="geometric optics",
    rule="what lies behind the first hits would change any pixel by more than the tolerance",
    cost=Cost.FREE,
    parameters=(),
    decide=decide,
    configure=configure,
    anywhere=True,
)
