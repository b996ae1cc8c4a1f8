"""Speckle: the scatterers of a cell add with random phases that belong to the surface."""

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import LEVEL_SPREAD_DB
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance

VARIATION = 0.5227
"""Standard deviation over mean of a Rayleigh amplitude."""


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On; expected powers are asked for by switching it off."""
    del view
    reason = f"echoes of many scatterers vary by {LEVEL_SPREAD_DB} dB"
    return Verdict(tolerance.texture < VARIATION, reason, LEVEL_SPREAD_DB)


def configure(physics: Physics, view: View) -> None:
    """Compute a field instead of mean powers."""
    del view
    physics.speckle = True


EFFECT = Effect(
    name="speckle",
    does="grains the picture; the grain stays on the surfaces when the sonar comes back",
    needs="surfaces or other scatterers",
    formula="sum of complex Gaussian scatterers, each with the phase of its path",
    source="Goodman 1975: Rayleigh amplitude, coefficient of variation 0.5227",
    rule="always, unless expected values are asked for",
    cost=Cost.SCATTERER,
    parameters=(Parameter("seed", "1", "of the scatterers"),),
    decide=decide,
    configure=configure,
)
