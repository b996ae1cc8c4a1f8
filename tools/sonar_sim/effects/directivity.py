"""Effects of directivity: beam patterns, bearings, range spread, crosstalk."""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from sonar_sim.effects.coarse_picture import equivalent_beams
from sonar_sim.effects.effect import (
    LEVEL_SPREAD_DB,
    ROW_CORRELATION,
    Cost,
    Effect,
    EffectParameter,
    RuleResult,
    by_cells,
    by_level,
)
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview, PoseSlack
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD, MAX_ELEVATION_RAD, USUAL_ELEVATIONS_RAD


def decide_azimuth_pattern(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On: beams overlap, or leave gaps between them."""
    del tolerance
    width = 2.0 * math.sin(view.sonar.beam_width_rad / 2.0)
    pitch = view.sonar.sine_pitch
    predicted_db = abs(10.0 * math.log10(equivalent_beams(view.sonar)))
    reason = f"a beam is {width / pitch:.1f} times as wide as the beams' distance"
    return RuleResult(on=True, reason=reason, predicted_db=predicted_db)


def configure_azimuth_pattern(physics: Physics, view: PingPreview) -> None:
    """Give the beam its width."""
    physics.beam_width_rad = view.sonar.beam_width_rad


AZIMUTH_PATTERN = Effect(
    name="azimuth_pattern",
    does="blurs the picture across the beams, the more so in angle the farther out",
    needs="beam width",
    formula="Gaussian main lobe over the difference of sines",
    source="line array shaded by a Gaussian, receive only: as a public recording shows",
    rule="always: beams overlap, or leave gaps between them",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.beam_width_rad", "rad", "-3 dB full width at broadside"),),
    decide=decide_azimuth_pattern,
    configure=configure_azimuth_pattern,
)


def decide_side_lobes(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if arcs rise out of what is in their rows anyway.

    An arc is as thin as its echo is short, and thinner ones are brighter: rows are those of the
    sonar.
    """
    fine = view.fine
    main = fine.grid.main_lobes(fine.echoes, fine.echo_power)
    # A single arc is an artefact to be seen, however few its pixels.
    anywhere = replace(tolerance, share=0.0)
    predicted_db = fine.change_db(fine.picture - fine.echo_picture + main, anywhere)
    reason = f"lobes {view.sonar.side_lobe_db:.0f} dB down of each row's echoes over its background"
    return by_level(predicted_db, tolerance, reason)


def configure_side_lobes(physics: Physics, view: PingPreview) -> None:
    """Give the lobes their level."""
    physics.side_lobe_db = view.sonar.side_lobe_db


SIDE_LOBES = Effect(
    name="side_lobes",
    does="draws arcs through bright echoes",
    needs="side lobe level, contrast within rows",
    formula="the azimuth pattern beyond its main lobe: equal lobes that fall by the square far off",
    source="Taylor 1955: a line array whose nearest side lobes are equally high",
    rule="always: it costs next to nothing",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.side_lobe_db", "dB", "under the main lobe, positive"),),
    decide=decide_side_lobes,
    configure=configure_side_lobes,
    anywhere=True,
)


def decide_vertical_pattern(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if echoes lie so far off the fan's plane that the picture changes."""
    echoes = view.echoes
    power = view.echo_power / np.maximum(view.pattern, 1e-12)
    low, high = (
        math.degrees(math.asin(v)) for v in (echoes.up.min(initial=0.0), echoes.up.max(initial=0.0))
    )
    reason = f"echoes at {low:.0f} to {high:.0f}° off the fan's plane"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure_vertical_pattern(physics: Physics, view: PingPreview) -> None:
    """Give the aperture its width."""
    physics.vertical_width_rad = view.sonar.vertical_width_rad


VERTICAL_PATTERN = Effect(
    name="vertical_pattern",
    does="darkens what is above or below the fan; leaves a dark ring at its null",
    needs="elevations",
    formula="sinc²(0.443 sin e / sin(width / 2)) each way, in power",
    source="unshaded aperture",
    rule="always: it costs next to nothing",
    cost=Cost.FREE,
    parameters=(EffectParameter("sonar.vertical_width_rad", "rad", "-3 dB full width, one way"),),
    decide=decide_vertical_pattern,
    configure=configure_vertical_pattern,
)


def decide_all_elevations(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if what lies beyond the elevations of the usual fan shows."""
    steep = np.abs(view.echoes.up) > math.sin(MAX_ELEVATION_RAD)
    share = f"{steep.mean() if len(steep) else 0.0:.0%} of what is met lies"
    reason = f"{share} more than {math.degrees(MAX_ELEVATION_RAD):.0f}° off the fan's plane"
    if not steep.any() and not view.clouds:
        return RuleResult(on=False, reason=reason, predicted_db=0.0)
    predicted_db = view.change_beyond_db(USUAL_ELEVATIONS_RAD, tolerance, PoseSlack())
    return by_level(predicted_db, tolerance, reason)


LIMITS_RAD = tuple(math.radians(degrees) for degrees in (40, 46, 54, 68, 90))
"""Elevations at which a fan may end."""


def elevations_that_show(
    view: PingPreview, tolerance: Tolerance, allowed_db: float, slack: PoseSlack
) -> tuple[float, float]:
    """Lowest and highest elevation, rad, beyond which nothing shows.

    Only floor and water are left out. Anything else may be too small for the coarse rays, or hidden
    from the view's pose and not from the ping's. A floor that reflects specularly cannot be judged
    so: its flash moves with the sonar.

    Args:
        view: of a ping.
        tolerance: its share of the pixels may change more.
        allowed_db: change of level by all that is left out.
        slack: how far the ping's pose may be from the view's.
    """
    full = LIMITS_RAD[-1]
    down_rad, up_rad = (_first_at_least(reach) for reach in view.reach_rad(slack))

    def shows(limits_rad: tuple[float, float], part: float) -> bool:
        return view.change_beyond_db(limits_rad, tolerance, slack) > part * allowed_db

    down_rad = _least(down_rad, lambda limit_rad: shows((-limit_rad, full), 0.5))
    up_rad = _least(up_rad, lambda limit_rad: shows((-down_rad, limit_rad), 1.0))
    return -down_rad, up_rad


def _first_at_least(reach_rad: float) -> float:
    return next((limit for limit in LIMITS_RAD if limit >= reach_rad), LIMITS_RAD[-1])


def _least(from_rad: float, shows: Callable[[float], bool]) -> float:
    """The first limit beyond which nothing shows; the last one is a right angle."""
    limits = [limit for limit in LIMITS_RAD if limit >= from_rad]
    return limits[bisect_left(limits[:-1], 1, key=lambda limit: 0 if shows(limit) else 1)]


def configure_all_elevations(physics: Physics, view: PingPreview) -> None:
    """Look up and down."""
    del view
    physics.elevations_rad = physics.mirrored_elevations_rad = ALL_ELEVATIONS_RAD


def within_elevations(effect: Effect, limits_rad: tuple[float, float]) -> Effect:
    """The effect, looking only so far down and up, but in mirrors everywhere."""
    return replace(effect, configure=partial(_configure_limits, limits_rad))


def _configure_limits(limits_rad: tuple[float, float], physics: Physics, view: PingPreview) -> None:
    configure_all_elevations(physics, view)
    physics.elevations_rad = limits_rad


ALL_ELEVATIONS = Effect(
    name="all_elevations",
    does="shows floor below and surface above a level sonar, by the vertical pattern's far lobes",
    needs="surfaces more than 40° off the fan's plane",
    formula="rays up to 90° off the fan's plane; what lies behind the sonar is not heard",
    source="geometry; the pattern of `vertical_pattern`",
    rule="the picture without these echoes differs by more than the tolerance; `auto` ends rays "
    "where floor and water no longer show",
    cost=Cost.RAY,
    parameters=(EffectParameter("sonar.vertical_width_rad", "rad", "-3 dB full width, one way"),),
    decide=decide_all_elevations,
    configure=configure_all_elevations,
)


def decide_bearing_table(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if equal angles would put any direction into another beam."""
    half_rad = view.sonar.half_aperture_rad
    place = np.linspace(-1.0, 1.0, view.sonar.beams)
    off = np.abs(np.sin(place * half_rad) - place * math.sin(half_rad)) / view.sonar.sine_pitch
    reason = f"equal angles are off over a fan of {2.0 * math.degrees(half_rad):.0f}°"
    return by_cells(float(off.max()), tolerance, reason)


def configure_bearing_table(physics: Physics, view: PingPreview) -> None:
    """Lay the beams by sine."""
    del view
    physics.sine_bearings = True


BEARING_TABLE = Effect(
    name="bearing_table",
    does="packs beams closely ahead and widely at the edges",
    needs="aperture",
    formula="asin(sin(half aperture) (2 i / (N - 1) - 1))",
    source="public Oculus recording, to 0.01°",
    rule="equal angles displace any direction by more than the tolerated part of a beam",
    cost=Cost.FREE,
    parameters=(
        EffectParameter("sonar.half_aperture_rad", "rad", "bearing of the outermost beams"),
    ),
    decide=decide_bearing_table,
    configure=configure_bearing_table,
)


def decide_range_spread(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the resolution of the pulse is not much finer than a row."""
    bandwidth_hz = view.sonar.bandwidth_hz(view.speed_of_sound_mps)
    resolution_rows = view.speed_of_sound_mps / (2.0 * bandwidth_hz) / view.sonar.range_resolution_m
    on = resolution_rows >= 0.5 and tolerance.texture < ROW_CORRELATION  # noqa: PLR2004 half a row
    reason = f"the pulse resolves {resolution_rows:.1f} rows; rows correlate {ROW_CORRELATION}"
    leak_db = LEVEL_SPREAD_DB * (2.0 * ROW_CORRELATION) ** 0.5
    return RuleResult(on, reason, leak_db)


def configure_range_spread(physics: Physics, view: PingPreview) -> None:
    """Let neighbouring rows overlap."""
    del view
    physics.range_spread = True


RANGE_SPREAD = Effect(
    name="range_spread",
    does="makes the speckle of neighbouring rows alike (correlation 0.19)",
    needs="bandwidth",
    formula="matched filter of width c / (2 B); a field leaks 0.24 into each neighbour",
    source="public Oculus recording: correlation of neighbouring rows 0.19",
    rule="c / (2 B) of at least half a row, and a tolerance of texture below the correlation",
    cost=Cost.CELL,
    parameters=(
        EffectParameter("sonar.base_row_m", "m", "finest row, which the bandwidth resolves"),
    ),
    decide=decide_range_spread,
    configure=configure_range_spread,
)


def decide_near_field(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the beams are not focused and something lies nearer than where they are sharp."""
    del tolerance
    focus_m = view.sonar.focus_m(view.speed_of_sound_mps)
    if view.sonar.dynamic_focus:
        return RuleResult(on=False, reason="beams are focused at every range", predicted_db=0.0)
    nearest_m = max(float(view.echoes.range_m.min(initial=np.inf)), view.sonar.range_resolution_m)
    wider_db = 10.0 * math.log10(max(focus_m / nearest_m, 1.0))
    reason = f"echoes from {nearest_m:.1f} m on, beams are sharp from {focus_m:.1f} m on"
    return RuleResult(on=wider_db > NEAR_FIELD_DB, reason=reason, predicted_db=wider_db)


def configure_near_field(physics: Physics, view: PingPreview) -> None:
    """Give the range from which beams are sharp."""
    physics.focus_m = (
        None if view.sonar.dynamic_focus else view.sonar.focus_m(view.speed_of_sound_mps)
    )


NEAR_FIELD_DB = 0.5
"""Width of a beam over its own from which it is blurred."""
NEAR_FIELD = Effect(
    name="near_field",
    does="widens beams near the sonar, unless it focuses them at every range",
    needs="length of the array: its beam width and wavelength",
    formula="width max(lambda / L, L / R) with L = 0.886 lambda / width; as much noise as ever",
    source="Fresnel zone of a line array",
    rule="the sonar does not focus, and an echo is nearer than L² / lambda",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.dynamic_focus", "1", "beams are focused at every range"),),
    decide=decide_near_field,
    configure=configure_near_field,
)


def decide_crosstalk(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the leak rises out of what is in the rows anyway."""
    level_db = view.sonar.crosstalk_db
    if level_db is None:
        return RuleResult(on=False, reason="the sonar has none", predicted_db=0.0)
    leak = 10.0 ** (level_db / 10.0) * view.picture.mean(axis=1, keepdims=True)
    reason = f"{level_db:.0f} dB of each row's mean over its background"
    return by_level(view.change_db(view.picture + leak, tolerance), tolerance, reason)


def configure_crosstalk(physics: Physics, view: PingPreview) -> None:
    """Give the level."""
    physics.crosstalk_db = view.sonar.crosstalk_db


CROSSTALK = Effect(
    name="crosstalk",
    does="lifts whole rows that hold bright echoes",
    needs="the sonar's crosstalk",
    formula="a part of the row's mean power in every beam",
    source="electrical leakage of -40 to -60 dB",
    rule="the leak changes the picture by more than the tolerance",
    cost=Cost.ROW,
    parameters=(EffectParameter("sonar.crosstalk_db", "dB", "of the row's mean power, negative"),),
    decide=decide_crosstalk,
    configure=configure_crosstalk,
)
