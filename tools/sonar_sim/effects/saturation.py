"""Saturation: what is louder than full scale looks like full scale."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.verdicts import by_level
from sonar_sim.effects.view import View
from sonar_sim.physics import Physics
from sonar_sim.picture_change import level_change_db
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if expected levels exceed full scale."""
    shown = view.amplitude
    predicted_db = level_change_db(np.minimum(shown, 1.0), shown, view.sonar, tolerance.share)
    loudest_db = 20.0 * math.log10(max(float(shown.max(initial=0.0)), 1e-6))
    return by_level(
        predicted_db, tolerance, f"the loudest echo is at {loudest_db:+.0f} dB of full scale"
    )


def configure(physics: Physics, view: View) -> None:
    """Clip."""
    del view
    physics.saturation = True


EFFECT = Effect(
    name="saturation",
    does="cuts bright echoes off at full scale",
    needs="gains",
    formula="min(amplitude, full scale)",
    source="the converter's end",
    rule="expected levels above full scale in more than the tolerated share of the picture",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.gain_percent", "%", "the operator's gain"),),
    decide=decide,
    configure=configure,
)
