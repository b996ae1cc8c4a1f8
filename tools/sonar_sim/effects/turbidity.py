"""Turbidity: suspended sediment takes sound away by friction and scattering."""

from dataclasses import replace

from sonar_sim.effects.clouds import clouds_of
from sonar_sim.effects.coarse import left_by
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.scene import Sediment
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if what sediment takes or sends back shows."""
    alpha = view.sediment_db_per_m
    if alpha == 0.0 and not view.clouds_of(Sediment):
        return Verdict(on=False, reason="the water is clear", predicted_db=0.0)
    left = left_by(2.0 * alpha * view.grid.range_m)[:, None]
    picture = view.heard_without(Sediment) / left + view.noise_power
    two_way_db = 2.0 * alpha * view.sonar.range_m
    reason = f"2 alpha R of sediment everywhere {two_way_db:.2f} dB at {view.sonar.range_m:.0f} m"
    # A cloud may fill few pixels; and what grains take costs next to nothing.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_db(picture, anywhere), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Add the sediment's share to the attenuation, and the clouds."""
    physics.attenuation_db_per_m += view.sediment_db_per_m
    physics.clouds = (*physics.clouds, *clouds_of(view, Sediment))


EFFECT = Effect(
    name="turbidity",
    does="dims what lies behind muddy water",
    needs="concentration and size of the grains",
    formula="phi (k⁴ a³ / 6 + k (sigma - 1)² s / (s² + (sigma + tau)²)) / 2 nepers a metre",
    source="Urick 1948",
    rule="any pixel in clear water differs by more than the tolerance",
    cost=Cost.ROW,
    parameters=(
        Parameter("water.sediment_kg_per_m3", "kg/m³", "concentration everywhere"),
        Parameter("water.sediment_radius_m", "m", "radius of the grains"),
        Parameter("cloud.matter", "kg/m³, m", "sediment in a box"),
    ),
    decide=decide,
    configure=configure,
    anywhere=True,
)
