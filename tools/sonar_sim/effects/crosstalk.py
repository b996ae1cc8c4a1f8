"""Crosstalk: a row's power leaks into all its beams through the electronics."""

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the leak rises out of what is in the rows anyway."""
    level_db = view.sonar.crosstalk_db
    if level_db is None:
        return Verdict(on=False, reason="the sonar has none", predicted_db=0.0)
    leak = 10.0 ** (level_db / 10.0) * view.picture.mean(axis=1, keepdims=True)
    reason = f"{level_db:.0f} dB of each row's mean over its background"
    return by_level(view.change_db(view.picture + leak, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the level."""
    physics.crosstalk_db = view.sonar.crosstalk_db


EFFECT = Effect(
    name="crosstalk",
    does="lifts whole rows that hold bright echoes",
    needs="the sonar's crosstalk",
    formula="a part of the row's mean power in every beam",
    source="electrical leakage of -40 to -60 dB",
    rule="the leak changes the picture by more than the tolerance",
    cost=Cost.ROW,
    parameters=(Parameter("sonar.crosstalk_db", "dB", "of the row's mean power, negative"),),
    decide=decide,
    configure=configure,
)
