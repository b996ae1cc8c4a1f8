"""Lambert's law: rough surfaces send back less the more they are seen edge on."""

import math

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if surfaces are not all seen head on."""
    echoes = view.echoes
    power = (echoes.even_m2 + echoes.lobe_m2) * view.unscattered
    steepest = math.degrees(math.acos(min(float(echoes.cos_incidence.min(initial=1.0)), 1.0)))
    reason = f"incidence up to {steepest:.0f}° from the normal"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Let scattering fall with incidence."""
    del view
    physics.lambert = True


EFFECT = Effect(
    name="lambert",
    does="shades surfaces by their slope",
    needs="normals, materials",
    formula="mu cos² i of back scattering a unit area",
    source="Lambert 1760; 10 log mu by material",
    rule="the picture with surfaces that scatter alike in all directions differs",
    cost=Cost.FREE,
    parameters=(Parameter("material.lambert_db", "dB", "10 log mu"),),
    decide=decide,
    configure=configure,
)
