"""Absorption: sea water turns sound into heat."""

from sonar_sim.effects.coarse import left_by
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if what is heard above the noise would be louder by more than the tolerance."""
    alpha = view.water_db_per_m
    left = left_by(2.0 * alpha * view.grid.range_m)[:, None]
    picture = view.heard / left + view.noise_power
    two_way_db = 2.0 * alpha * view.sonar.range_m
    reason = f"2 alpha R = {two_way_db:.1f} dB at {view.sonar.range_m:.0f} m"
    return by_level(view.change_in_place_db(picture, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Add the water's share to the attenuation."""
    physics.attenuation_db_per_m += view.water_db_per_m


EFFECT = Effect(
    name="absorption",
    does="makes far echoes fainter still, the more so the higher the frequency",
    needs="temperature, salinity, depth, acidity",
    formula="A1 P1 f1 f²/(f²+f1²) + A2 P2 f2 f²/(f²+f2²) + A3 P3 f², dB/km, f in kHz",
    source="Francois and Garrison 1982; Ainslie and McColm 1998 as the alternative",
    rule="2 alpha R changes the picture by more than the tolerance where it is above the noise",
    cost=Cost.ROW,
    parameters=(
        Parameter("water.temperature_c", "°C", "temperature"),
        Parameter("water.salinity_ppt", "ppt", "salinity"),
        Parameter("water.depth_m", "m", "depth at which the formula is taken"),
        Parameter("water.acidity_ph", "pH", "acidity"),
        Parameter("water.absorption_model", "1", "whose formula"),
    ),
    decide=decide,
    configure=configure,
)
