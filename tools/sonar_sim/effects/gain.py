"""Gain: the operator's, alike for all rows."""

from sonar_sim.effects.coarse import Gains, change_db
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.gain import GAIN_DB_PER_PERCENT
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the picture without it differs."""
    none = Gains(view.gains.varied_db, 0.0, view.gains.full_scale_db)
    predicted_db = change_db(view.amplitude, none.amplitude(view.picture), view.sonar, tolerance)
    reason = f"{view.sonar.gain_percent:.0f} % are {view.gains.operator_db:.0f} dB"
    return by_level(predicted_db, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Switch the operator's gain on."""
    del view
    physics.gain = True


EFFECT = Effect(
    name="gain",
    does="makes the whole picture brighter",
    needs="the operator's setting",
    formula=f"{GAIN_DB_PER_PERCENT} dB a percent",
    source="a choice: the device's own law is not published",
    rule="the picture without it differs by more than the tolerance",
    cost=Cost.ROW,
    parameters=(Parameter("sonar.gain_percent", "%", "the operator's gain"),),
    decide=decide,
    configure=configure,
)
