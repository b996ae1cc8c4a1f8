"""Bottom reverberation: the floor under everything scatters."""

from dataclasses import replace

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the floor's echo shows."""
    if not view.bottoms:
        return Verdict(on=False, reason="the scene has no floor", predicted_db=0.0)
    places = [i for i, s in enumerate(view.scene.surfaces) if s.name in view.bottoms]
    floor = np.isin(view.echoes.surface, places)
    power = np.where(floor, 0.0, view.echo_power)
    reason = f"{floor.mean() if len(floor) else 0.0:.0%} of what is heard is the floor's"
    # A small plate that lies alone is its scene's lowest surface: few pixels, but the only target.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_of_echoes_db(power, anywhere), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Take the floor out of what is silent."""
    physics.silent = physics.silent - view.bottoms


EFFECT = Effect(
    name="bottom_reverberation",
    does="shows the floor",
    needs="a floor: a surface that faces up and reaches the scene's lowest point",
    formula="mu cos² i a unit area",
    source="Lambert's law with the floor's 10 log mu",
    rule="a silent floor would change any pixel by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(Parameter("material.lambert_db", "dB", "10 log mu of the floor"),),
    decide=decide,
    configure=configure,
    anywhere=True,
)
