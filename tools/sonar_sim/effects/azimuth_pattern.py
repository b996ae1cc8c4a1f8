"""Azimuth pattern: a beam hears its neighbours' directions too, through its main lobe."""

import math

from sonar_sim.effects.coarse import equivalent_beams
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if a beam is wider than half the beams' distance."""
    del tolerance
    width = 2.0 * math.sin(view.sonar.beam_width_rad / 2.0)
    pitch = view.sonar.sine_pitch
    predicted_db = abs(10.0 * math.log10(equivalent_beams(view.sonar)))
    reason = f"a beam is {width / pitch:.1f} times as wide as the beams' distance"
    return Verdict(width > pitch / 2.0, reason, predicted_db)


def configure(physics: Physics, view: View) -> None:
    """Give the beam its width."""
    physics.beam_width_rad = view.sonar.beam_width_rad


EFFECT = Effect(
    name="azimuth_pattern",
    does="blurs the picture across the beams, the more so in angle the farther out",
    needs="beam width",
    formula="Gaussian main lobe over the difference of sines",
    source="line array shaded by a Gaussian, receive only: as a public recording shows",
    rule="beam width above half the beams' distance",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.beam_width_rad", "rad", "-3 dB full width at broadside"),),
    decide=decide,
    configure=configure,
)
