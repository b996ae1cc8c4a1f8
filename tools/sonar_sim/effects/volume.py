"""Volume reverberation: plankton and suspended grains in the water send a little back."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def strength_db(view: View) -> float:
    """Back scattering of the open water, grains included, dB re 1/m."""
    return 10.0 * math.log10(max(view.volume_strength, 1e-30))


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the water's echo rises out of noise and quantiser somewhere."""
    predicted_db = view.change_db(np.maximum(view.picture - view.volume_picture, 0.0), tolerance)
    return by_level(
        predicted_db, tolerance, f"S_v = {strength_db(view):.0f} dB re 1/m against noise"
    )


def configure(physics: Physics, view: View) -> None:
    """Give the water its strength."""
    physics.volume_strength_db = strength_db(view)


EFFECT = Effect(
    name="volume",
    does="fills the water with a faint haze",
    needs="volume strength, sediment",
    formula="RL = SL - 40 log R - 2 alpha R + S_v + 10 log(dR Psi R²)",
    source="Urick, Principles of Underwater Sound; grains by Rayleigh's law (Johnson 1977)",
    rule="the picture without it differs by more than the tolerance",
    cost=Cost.CELL,
    parameters=(
        Parameter("water.volume_strength_db", "dB re 1/m", "S_v"),
        Parameter("water.sediment_kg_per_m3", "kg/m³", "adds its own back scattering"),
    ),
    decide=decide,
    configure=configure,
)
