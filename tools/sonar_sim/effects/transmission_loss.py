"""Effects of transmission loss: spreading, absorption, turbidity, bubbles."""

from dataclasses import replace

from sonar_sim.effects.coarse_picture import transmitted_power
from sonar_sim.effects.effect import Cost, Effect, EffectParameter, RuleResult, by_level
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.physics import Cloud, Physics
from sonar_sim.scene.scene import Bubbles, Sediment


def decide_spreading(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On wherever anything but a range of 1 m is heard."""
    echoes = view.echoes
    if len(echoes.range_m) == 0:
        return RuleResult(
            on=True, reason="the water itself echoes at all ranges", predicted_db=40.0
        )
    near_m, far_m = float(echoes.range_m.min()), view.far_m
    predicted_db = view.change_of_echoes_db(view.echo_power * echoes.range_m**4, tolerance)
    return by_level(predicted_db, tolerance, f"echoes from {near_m:.1f} to {far_m:.1f} m")


def configure_spreading(physics: Physics, view: PingPreview) -> None:
    """Let the amplitude fall with range."""
    del view
    physics.spreading = True


SPREADING = Effect(
    name="spreading",
    does="makes far echoes faint",
    needs="ranges",
    formula="two-way loss 40 log R",
    source="spherical waves; Urick, Principles of Underwater Sound",
    rule="always: it costs next to nothing",
    cost=Cost.FREE,
    parameters=(),
    decide=decide_spreading,
    configure=configure_spreading,
)


def decide_absorption(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if what is heard above the noise would be louder by more than the tolerance."""
    alpha = view.water_db_per_m
    left = transmitted_power(2.0 * alpha * view.grid.range_m)[:, None]
    picture = view.heard / left + view.noise_power
    two_way_db = 2.0 * alpha * view.sonar.range_m
    reason = f"2 alpha R = {two_way_db:.1f} dB at {view.sonar.range_m:.0f} m"
    return by_level(view.change_in_place_db(picture, tolerance), tolerance, reason)


def configure_absorption(physics: Physics, view: PingPreview) -> None:
    """Add the water's share to the attenuation."""
    physics.attenuation_db_per_m += view.water_db_per_m


ABSORPTION = Effect(
    name="absorption",
    does="makes far echoes fainter still, the more so the higher the frequency",
    needs="temperature, salinity, depth, acidity",
    formula="A1 P1 f1 f²/(f²+f1²) + A2 P2 f2 f²/(f²+f2²) + A3 P3 f², dB/km, f in kHz",
    source="Francois and Garrison 1982; Ainslie and McColm 1998 as the alternative",
    rule="2 alpha R of the last row is above the tolerance",
    cost=Cost.ROW,
    parameters=(
        EffectParameter("water.temperature_c", "°C", "temperature"),
        EffectParameter("water.salinity_ppt", "ppt", "salinity"),
        EffectParameter("water.depth_m", "m", "depth at which the formula is taken"),
        EffectParameter("water.acidity_ph", "pH", "acidity"),
        EffectParameter("water.absorption_model", "1", "whose formula"),
    ),
    decide=decide_absorption,
    configure=configure_absorption,
)


def clouds_of(view: PingPreview, kind: type[Bubbles] | type[Sediment]) -> tuple[Cloud, ...]:
    """The scene's clouds of one kind."""
    return tuple(cloud.box for cloud in view.clouds_of(kind))


def decide_turbidity(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if what sediment takes or sends back shows."""
    alpha = view.sediment_db_per_m
    if alpha == 0.0 and not view.clouds_of(Sediment):
        return RuleResult(on=False, reason="the water is clear", predicted_db=0.0)
    left = transmitted_power(2.0 * alpha * view.grid.range_m)[:, None]
    picture = view.heard_without(Sediment) / left + view.noise_power
    two_way_db = 2.0 * alpha * view.sonar.range_m
    reason = f"2 alpha R of sediment everywhere {two_way_db:.2f} dB at {view.sonar.range_m:.0f} m"
    # A cloud may fill few pixels; and what grains take costs next to nothing.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_db(picture, anywhere), tolerance, reason)


def configure_turbidity(physics: Physics, view: PingPreview) -> None:
    """Add the sediment's share to the attenuation, and the clouds."""
    physics.attenuation_db_per_m += view.sediment_db_per_m
    physics.clouds = (*physics.clouds, *clouds_of(view, Sediment))


TURBIDITY = Effect(
    name="turbidity",
    does="dims what lies behind muddy water",
    needs="concentration and size of the grains",
    formula="phi (k⁴ a³ / 6 + k (sigma - 1)² s / (s² + (sigma + tau)²)) / 2 nepers a metre",
    source="Urick 1948",
    rule="any pixel in clear water differs by more than the tolerance",
    cost=Cost.ROW,
    parameters=(
        EffectParameter("water.sediment_kg_per_m3", "kg/m³", "concentration everywhere"),
        EffectParameter("water.sediment_radius_m", "m", "radius of the grains"),
        EffectParameter("cloud.matter", "kg/m³, m", "sediment in a box"),
    ),
    decide=decide_turbidity,
    configure=configure_turbidity,
    anywhere=True,
)


def decide_bubbles(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if a declared cloud of bubbles is in sight and shows."""
    clouds = view.clouds_of(Bubbles)
    if not clouds:
        return RuleResult(on=False, reason="the scene declares no bubbles", predicted_db=0.0)
    deepest_db = float(view.two_way_cloud_db(clouds, view.echoes).max(initial=0.0))
    reason = f"clouds take up to {deepest_db:.1f} dB of what is behind"
    # A plume fills few pixels and is faint, but it is what one looks for.
    anywhere = replace(tolerance, share=0.0)
    picture = view.heard_without(Bubbles) + view.noise_power
    return by_level(view.change_db(picture, anywhere), tolerance, reason)


def configure_bubbles(physics: Physics, view: PingPreview) -> None:
    """Add the clouds."""
    physics.clouds = (*physics.clouds, *clouds_of(view, Bubbles))


BUBBLES = Effect(
    name="bubbles",
    does="draws plumes, and dims what lies behind them",
    needs="declared clouds",
    formula="4.34 n 2 pi a² dB/m; back scattering n a² / 4",
    source="geometric optics above the resonance 3.26 / a Hz (Minnaert)",
    rule="any pixel without the clouds differs by more than the tolerance",
    cost=Cost.RAY,
    parameters=(
        EffectParameter("cloud.low_m", "m", "corner of the box, and high_m the other"),
        EffectParameter("bubbles.radius_m", "m", "of each"),
        EffectParameter("bubbles.per_m3", "1/m³", "number"),
    ),
    decide=decide_bubbles,
    configure=configure_bubbles,
    anywhere=True,
)
