"""Effects of scattering: surfaces, their shadows, speckle and reverberation."""

import math
from dataclasses import replace

import numpy as np

from sonar_sim.effects.coarse_picture import change_db
from sonar_sim.effects.echoes import is_sea
from sonar_sim.effects.effect import (
    LEVEL_SPREAD_DB,
    Cost,
    Effect,
    EffectParameter,
    RuleResult,
    by_level,
)
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.multipath import ghost_picture
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Physics


def decide_lambert(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if surfaces are not all seen head on."""
    echoes = view.echoes
    power = (echoes.isotropic_m2 + echoes.lobe_m2) * view.power_per_m2
    steepest = math.degrees(math.acos(min(float(echoes.cos_incidence.min(initial=1.0)), 1.0)))
    reason = f"incidence up to {steepest:.0f}° from the normal"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure_lambert(physics: Physics, view: PingPreview) -> None:
    """Let scattering fall with incidence."""
    del view
    physics.lambert = True


LAMBERT = Effect(
    name="lambert",
    does="shades surfaces by their slope",
    needs="normals, materials",
    formula="mu cos² i of back scattering a unit area",
    source="Lambert 1760; 10 log mu by material",
    rule="wherever there are surfaces: it costs next to nothing",
    cost=Cost.FREE,
    parameters=(EffectParameter("material.lambert_db", "dB", "10 log mu"),),
    decide=decide_lambert,
    configure=configure_lambert,
)


def decide_specular(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the lobe of a smooth surface reaches back to the sonar."""
    echoes = view.echoes
    # A ball's flash or a distant plate's fills few pixels, but those are what one looks for.
    anywhere = replace(tolerance, share=0.0)
    predicted_db = view.change_of_echoes_db(echoes.lambert_m2 * view.power_per_m2, anywhere)
    flashing = {
        view.scene.surfaces[i].name
        for i in set(echoes.surface[echoes.lobe_m2 > echoes.lambert_m2].tolist())
        if i >= 0
    }
    named = ", ".join(sorted(flashing)[:3]) if flashing else "no smooth surface"
    return by_level(predicted_db, tolerance, f"{named} mirrors more than it scatters")


def configure_specular(physics: Physics, view: PingPreview) -> None:
    """Add the lobe."""
    del view
    physics.specular = True


SPECULAR = Effect(
    name="specular",
    does="lets smooth surfaces flash where they face the sonar",
    needs="reflection, roughness, slopes of materials; normals",
    formula="|G|² exp(-4 k² h² cos² i) sec⁴ i / (8 pi s²) exp(-tan² i / (2 s²)) a unit area",
    source="geometric optics of a rough surface (Kirchhoff); Rayleigh's roughness",
    rule="any pixel without the lobe differs by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(
        EffectParameter("material.reflection", "1", "of pressure, signed"),
        EffectParameter("material.roughness_m", "m", "standard deviation of the height"),
        EffectParameter("material.slope_rad", "rad", "standard deviation of the slope"),
    ),
    decide=decide_specular,
    configure=configure_specular,
    anywhere=True,
)


def decide_shadows(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if a second cast from behind the first hits finds echoes that would show."""
    hidden = view.hidden
    if len(hidden.range_m) == 0:
        return RuleResult(on=False, reason="nothing lies behind anything", predicted_db=0.0)
    pattern = vertical_two_way_power(hidden.up, view.sonar.vertical_width_rad)
    behind = view.grid.picture(
        hidden, hidden.section_m2 * view.on_axis_power_per_m2(hidden) * pattern
    )
    share = len(hidden.range_m) / len(view.echoes.range_m)
    reason = f"behind {share:.0%} of what is hit lies something else in range"
    # Without shadows a rod's far side shows behind its near one: few pixels, but the only target.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_db(view.picture + behind, anywhere), tolerance, reason)


def configure_shadows(physics: Physics, view: PingPreview) -> None:
    """Stop each ray at what it meets first."""
    del view
    physics.shadows = True


SHADOWS = Effect(
    name="shadows",
    does="leaves dark what is behind something",
    needs="geometry",
    formula="the nearest hit of a ray ends it",
    source="geometric optics",
    rule="wherever there are surfaces: to look behind them costs more",
    cost=Cost.FREE,
    parameters=(),
    decide=decide_shadows,
    configure=configure_shadows,
    anywhere=True,
)


VARIATION = 0.5227
"""Standard deviation over mean of a Rayleigh amplitude."""


def decide_speckle(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On; expected powers are asked for by switching it off."""
    del view
    reason = f"echoes of many scatterers vary by {LEVEL_SPREAD_DB} dB"
    return RuleResult(tolerance.texture < VARIATION, reason, LEVEL_SPREAD_DB)


def configure_speckle(physics: Physics, view: PingPreview) -> None:
    """Compute a field instead of mean powers."""
    del view
    physics.speckle = True


SPECKLE = Effect(
    name="speckle",
    does="grains the picture; the grain stays on the surfaces when the sonar comes back",
    needs="surfaces or other scatterers",
    formula="sum of complex Gaussian scatterers, each with the phase of its path",
    source="Goodman 1975: Rayleigh amplitude, coefficient of variation 0.5227",
    rule="always, unless expected values are asked for",
    cost=Cost.SCATTERER,
    parameters=(EffectParameter("seed", "1", "of the scatterers"),),
    decide=decide_speckle,
    configure=configure_speckle,
)


def strength_db(view: PingPreview) -> float:
    """Back scattering of the open water, grains included, dB re 1/m."""
    return 10.0 * math.log10(max(view.volume_strength, 1e-30))


def decide_volume(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the water's echo rises out of noise and quantiser somewhere."""
    predicted_db = view.change_db(np.maximum(view.picture - view.volume_picture, 0.0), tolerance)
    return by_level(
        predicted_db, tolerance, f"S_v = {strength_db(view):.0f} dB re 1/m against noise"
    )


def configure_volume(physics: Physics, view: PingPreview) -> None:
    """Give the water its strength."""
    physics.volume_strength_db = strength_db(view)


VOLUME = Effect(
    name="volume",
    does="fills the water with a faint haze",
    needs="volume strength, sediment",
    formula="RL = SL - 40 log R - 2 alpha R + S_v + 10 log(dR Psi R²)",
    source="Urick, Principles of Underwater Sound; grains by Rayleigh's law (Johnson 1977)",
    rule="the picture without it differs by more than the tolerance",
    cost=Cost.CELL,
    parameters=(
        EffectParameter("water.volume_strength_db", "dB re 1/m", "S_v"),
        EffectParameter("water.sediment_kg_per_m3", "kg/m³", "adds its own back scattering"),
    ),
    decide=decide_volume,
    configure=configure_volume,
)


def decide_reverberation(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the tail rises out of noise, water and quantiser somewhere."""
    # Ghosts may fill what were dark without them, and leave a tail as well.
    ghosts = ghost_picture(view)
    of_ghosts = view.tail_of(ghosts)
    picture = view.picture + ghosts + of_ghosts
    tail = view.tail_picture + of_ghosts
    before, after = (view.gains.amplitude(power) for power in (picture, picture - tail))
    predicted_db = change_db(before, after, view.sonar, tolerance, displaced=False)
    loudest = view.gains.amplitude(tail).max(initial=0.0)
    loudest_db = 20.0 * math.log10(max(float(loudest), 1e-6))
    return by_level(predicted_db, tolerance, f"the tail reaches {loudest_db:.0f} dB of full scale")


def configure_reverberation(physics: Physics, view: PingPreview) -> None:
    """Give the tail its energy and decay."""
    physics.reverberation = view.reverberation


REVERBERATION = Effect(
    name="reverberation",
    does="lets floors and walls fade into a tail behind them",
    needs="echoes",
    formula="power a metre of 10^(level / 10) of the echoes' energy so far, fading with range",
    source="public Oculus recording: -18.5 dB/m behind a floor, fading by 14 dB/m",
    rule="wherever there are echoes: it costs as little as deciding",
    cost=Cost.CELL,
    parameters=(
        EffectParameter("water.reverberation_db", "dB re 1/m", "energy of the tail"),
        EffectParameter("water.reverberation_decay_db_per_m", "dB/m", "by which it fades"),
    ),
    decide=decide_reverberation,
    configure=configure_reverberation,
)


def decide_surface_reverberation(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the surface's echo shows."""
    if view.scene.sea is None:
        return RuleResult(on=False, reason="the scene has no sea surface", predicted_db=0.0)
    sea = is_sea(view.echoes)
    power = np.where(sea, 0.0, view.echo_power)
    reason = f"{sea.mean() if len(sea) else 0.0:.0%} of what is heard is the surface's"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure_surface_reverberation(physics: Physics, view: PingPreview) -> None:
    """Let the surface scatter."""
    physics.sea_surface = view.scene.sea is not None


SURFACE_REVERBERATION = Effect(
    name="surface_reverberation",
    does="shows the sea's surface from below",
    needs="a sea surface in sight",
    formula="mu cos² i a unit area of the plane z = 0",
    source="Lambert's law with 10 log mu of -20 to -10 dB, bubbles included",
    rule="the picture without the surface's echo differs by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(EffectParameter("sea.lambert_db", "dB", "10 log mu of the surface"),),
    decide=decide_surface_reverberation,
    configure=configure_surface_reverberation,
)


def decide_bottom_reverberation(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the floor's echo shows."""
    if not view.bottoms:
        return RuleResult(on=False, reason="the scene has no floor", predicted_db=0.0)
    places = [i for i, s in enumerate(view.scene.surfaces) if s.name in view.bottoms]
    floor = np.isin(view.echoes.surface, places)
    power = np.where(floor, 0.0, view.echo_power)
    reason = f"{floor.mean() if len(floor) else 0.0:.0%} of what is heard is the floor's"
    # A small plate that lies alone is its scene's lowest surface: few pixels, but the only target.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_of_echoes_db(power, anywhere), tolerance, reason)


def configure_bottom_reverberation(physics: Physics, view: PingPreview) -> None:
    """Take the floor out of what is silent."""
    physics.silent = physics.silent - view.bottoms


BOTTOM_REVERBERATION = Effect(
    name="bottom_reverberation",
    does="shows the floor",
    needs="a floor: a surface that faces up and reaches the scene's lowest point",
    formula="mu cos² i a unit area",
    source="Lambert's law with the floor's 10 log mu",
    rule="a silent floor would change any pixel by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(EffectParameter("material.lambert_db", "dB", "10 log mu of the floor"),),
    decide=decide_bottom_reverberation,
    configure=configure_bottom_reverberation,
    anywhere=True,
)
