"""Spreading: sound thins out on its way, there and back."""

from sonar_sim.effects.effect import Cost, Effect, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On wherever anything but a range of 1 m is heard."""
    echoes = view.echoes
    if len(echoes.range_m) == 0:
        return Verdict(on=True, reason="the water itself echoes at all ranges", predicted_db=40.0)
    near_m, far_m = float(echoes.range_m.min()), view.far_m
    predicted_db = view.change_of_echoes_db(view.echo_power * echoes.range_m**4, tolerance)
    return by_level(predicted_db, tolerance, f"echoes from {near_m:.1f} to {far_m:.1f} m")


def configure(physics: Physics, view: View) -> None:
    """Let the amplitude fall with range."""
    del view
    physics.spreading = True


EFFECT = Effect(
    name="spreading",
    does="makes far echoes faint",
    needs="ranges",
    formula="two-way loss 40 log R",
    source="spherical waves; Urick, Principles of Underwater Sound",
    rule="40 log R of what is heard changes the picture by more than the tolerance",
    cost=Cost.FREE,
    parameters=(),
    decide=decide,
    configure=configure,
)
