"""Quantisation: pixels are integers of 8, 16 or 32 bits."""

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.picture_change import quantiser_change_db
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On: an Oculus sends integers. What rounding does to the picture is told."""
    shown = np.minimum(view.amplitude, 1.0)
    predicted_db = quantiser_change_db(shown, view.sonar, tolerance.share)
    return Verdict(on=True, reason=f"{view.sonar.bits} bits a sample", predicted_db=predicted_db)


def configure(physics: Physics, view: View) -> None:
    """Round to integers."""
    del view
    physics.quantised = True


EFFECT = Effect(
    name="quantisation",
    does="rounds, which shows in what is dark",
    needs="width of a sample",
    formula="round(full scale * amplitude^gamma)",
    source="Oculus data format: 8, 16 or 32 bits",
    rule="always, since an Oculus sends integers",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.bits", "bit", "of a sample"),),
    decide=decide,
    configure=configure,
)
