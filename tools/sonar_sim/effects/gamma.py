"""Gamma: the receiver's curve, which lifts what is dark."""

import numpy as np

from sonar_sim.effects.coarse import change_db
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.picture_change import gamma_of
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if linear pixels, read by the sonar's curve, show other levels."""
    gamma = gamma_of(view.sonar)
    shown = np.minimum(view.amplitude, 1.0)
    predicted_db = change_db(shown, shown ** (1.0 / gamma), view.sonar, tolerance)
    return by_level(predicted_db, tolerance, f"pixels go with the amplitude's power {gamma:.2f}")


def configure(physics: Physics, view: View) -> None:
    """Obey the byte."""
    del view
    physics.gamma = True


EFFECT = Effect(
    name="gamma",
    does="brings a wider range of levels into the pixels",
    needs="the gamma byte",
    formula="pixel = full scale * amplitude^(byte / 255); 0 and 255 are linear",
    source="public Oculus recording: byte 127 shows the amplitude's square root",
    rule="linear pixels differ by more than the tolerance",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.gamma_byte", "1", "0 to 255"),),
    decide=decide,
    configure=configure,
)
