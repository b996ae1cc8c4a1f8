"""Surface reverberation: the sea's surface and the bubbles under it scatter."""

import numpy as np

from sonar_sim.effects.echoes import is_sea
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the surface's echo shows."""
    if view.scene.sea is None:
        return Verdict(on=False, reason="the scene has no sea surface", predicted_db=0.0)
    sea = is_sea(view.echoes)
    power = np.where(sea, 0.0, view.echo_power)
    reason = f"{sea.mean() if len(sea) else 0.0:.0%} of what is heard is the surface's"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Let the surface scatter."""
    physics.sea_surface = view.scene.sea is not None


EFFECT = Effect(
    name="surface_reverberation",
    does="shows the sea's surface from below",
    needs="a sea surface in sight",
    formula="mu cos² i a unit area of the plane z = 0",
    source="Lambert's law with 10 log mu of -20 to -10 dB, bubbles included",
    rule="the picture without the surface's echo differs by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(Parameter("sea.lambert_db", "dB", "10 log mu of the surface"),),
    decide=decide,
    configure=configure,
)
