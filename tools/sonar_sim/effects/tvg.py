"""Time-varied gain: the receiver lifts the far rows."""

import numpy as np

from sonar_sim.effects.coarse import Gains, change_db
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the picture without it differs."""
    gains = view.gains
    flat = Gains(np.zeros_like(gains.varied_db), gains.operator_db, gains.full_scale_db)
    predicted_db = change_db(view.amplitude, flat.amplitude(view.picture), view.sonar, tolerance)
    reason = f"{gains.varied_db[0]:.0f} to {gains.varied_db[-1]:.0f} dB over the rows"
    return by_level(predicted_db, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Switch the receiver's gain on."""
    del view
    physics.tvg = True


EFFECT = Effect(
    name="tvg",
    does="levels near and far",
    needs="the receiver's law",
    formula="a log R + 2 alpha R dB",
    source="public Oculus recording: 30 log R + 2 alpha R",
    rule="the picture without it differs by more than the tolerance",
    cost=Cost.ROW,
    parameters=(Parameter("sonar.tvg_spreading_log", "dB a decade", "a"),),
    decide=decide,
    configure=configure,
)
