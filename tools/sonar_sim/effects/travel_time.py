"""Effects of travel time: sound speed, refraction, motion and Doppler shift."""

import math

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.displacement import (
    displaced_cells,
    displacement_result,
    doppler_shift_s,
    path_bending,
    range_scale,
    sonar_speed_mps,
    sonar_turn_rate_rps,
    visible_parts,
)
from sonar_sim.effects.echoes import GRAZING
from sonar_sim.effects.effect import (
    Cost,
    Effect,
    EffectParameter,
    RuleResult,
    by_level,
    displaced_db,
)
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Physics, SoundSpeedProfile
from sonar_sim.raycast.fan import CENTRE_SINE, ELEVATIONS


def decide_sound_speed(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the farthest echo moves by more than the tolerated part of a row."""
    assumed_mps = view.sonar.told_speed_mps or view.speed_of_sound_mps
    speeds = f"assumed {assumed_mps:.1f} m/s, true {view.speed_of_sound_mps:.1f} m/s"
    reason = f"{speeds}, echoes to {view.far_m:.1f} m"
    return displacement_result("sound_speed", view, tolerance, reason)


def configure_sound_speed(physics: Physics, view: PingPreview) -> None:
    """Scale the apparent ranges."""
    physics.range_scale = range_scale(view)


SOUND_SPEED = Effect(
    name="sound_speed",
    does="shifts ranges by the error of the speed that the sonar assumes",
    needs="true and assumed speed of sound",
    formula="dR / R = dc / c; c by Medwin 1975 or the profile",
    source="Medwin 1975",
    rule="the picture's parts move too far with this and the lesser effects left out",
    cost=Cost.FREE,
    parameters=(
        EffectParameter(
            "sonar.told_speed_mps", "m/s", "speed that the sonar assumes; without it the true one"
        ),
        EffectParameter("water.profile", "m, m/s", "speed over depth"),
    ),
    decide=decide_sound_speed,
    configure=configure_sound_speed,
)


RAY_RAD = 2.0 * CENTRE_SINE / ELEVATIONS
"""Between rays of a column, on the fan's plane: what is as narrow is hit or passed by, and a flash
comes or goes, if paths turn by as much."""
MAX_TURN = 0.3
"""rad; a steeper bend is beyond the rule's small angles, and called for anyway."""


def decide_refraction(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the bend changes incidence and pattern, or the profile's speeds move echoes."""
    gradient = view.scene.water.largest_gradient_per_s
    if gradient == 0.0 or len(view.echoes.range_m) == 0:
        return RuleResult(
            on=False, reason="the speed of sound does not change with depth", predicted_db=0.0
        )
    turn = path_bending(view).turn_rad
    largest = float(np.abs(turn).max(initial=0.0))
    reason = (
        f"largest gradient {gradient:.2g} /s, paths leave up to {math.degrees(largest):.2g}° off"
    )
    if largest > MAX_TURN:
        return RuleResult(on=True, reason=reason, predicted_db=40.0)
    passed_by = largest / RAY_RAD
    if passed_by > tolerance.cells:
        return RuleResult(on=True, reason=reason, predicted_db=displaced_db(passed_by))
    level = by_level(
        view.change_of_echoes_db(_bent_power(view, turn), tolerance), tolerance, reason
    )
    moved = displacement_result("refraction", view, tolerance, reason)
    return moved if moved.on and not level.on else level


def _bent_power(view: PingPreview, turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power of each echo if its path leaves and arrives turned about the horizontal, (N,)."""
    echoes = view.echoes
    ahead = echoes.direction @ view.map_T_sonar.rotation.T
    flat = np.maximum(np.hypot(ahead[:, 0], ahead[:, 1]), GRAZING)
    # The derivative of a unit direction by its elevation, map frame.
    lift = np.stack(
        [-ahead[:, 2] * ahead[:, 0] / flat, -ahead[:, 2] * ahead[:, 1] / flat, flat], axis=1
    )
    left = echoes.up + turn_rad * (lift @ view.map_T_sonar.rotation)[:, 2]
    pattern = vertical_two_way_power(left, view.sonar.vertical_width_rad)
    # An arc arrives as much flatter as it left steeper.
    facing = np.abs(np.sum(echoes.normal * (ahead - turn_rad[:, None] * lift), axis=1))
    point = ~np.any(echoes.normal, axis=1)
    ratio = np.where(point, 1.0, facing / np.maximum(echoes.cos_incidence, GRAZING))
    power: NDArray[np.float64] = (
        view.echo_power * np.square(ratio) * pattern / np.maximum(view.pattern, 1e-12)
    )
    return power


def configure_refraction(physics: Physics, view: PingPreview) -> None:
    """Give the profile."""
    profile = view.scene.water.profile
    if profile is not None:
        depth_m, speed_mps = np.array(profile, dtype=np.float64).T
        physics.layers = SoundSpeedProfile(
            np.ascontiguousarray(depth_m), np.ascontiguousarray(speed_mps)
        )


REFRACTION = Effect(
    name="refraction",
    does="bends paths: other incidence, other part of the vertical pattern, moved echoes",
    needs="a profile of sound speed",
    formula="curvature g cos(elevation) / c, half of it at each end; range by mean c0 / c",
    source="Snell's law in a constant gradient",
    rule="paths turn by the tolerated part of the rays' distance, or levels or ranges change more",
    cost=Cost.RAY,
    parameters=(EffectParameter("water.profile", "m, m/s", "speed of sound over depth"),),
    decide=decide_refraction,
    configure=configure_refraction,
)


MIN_BLOCKS, MAX_BLOCKS = 4, 16
BLOCK_CELLS = 0.25
"""Motion within a block of rows, at most, until there are `MAX_BLOCKS`."""


def decide_motion(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if range shifts or the picture turns by more than the tolerated part of a cell."""
    turn = math.degrees(sonar_turn_rate_rps(view))
    reason = f"{_speeds(view)}, {turn:.1f}°/s, echoes to {view.far_m:.0f} m"
    return displacement_result("motion", view, tolerance, reason)


def _speeds(view: PingPreview) -> str:
    """Speed of the sonar, and of what comes nearer or leaves the fastest."""
    objects = float(np.abs(visible_parts(view).leaving_mps).max(initial=0.0))
    also = f", objects {objects:.2f} m/s" if objects else ""
    return f"{sonar_speed_mps(view):.2f} m/s{also}"


def configure_motion(physics: Physics, view: PingPreview) -> None:
    """Give the ping as many poses as keep the motion within each small."""
    # What the coarse rays miss turns by no more than this until the last row is heard.
    listening_s = 2.0 * view.sonar.range_m / view.speed_of_sound_mps
    turned = sonar_turn_rate_rps(view) * listening_s / view.sonar.sine_pitch
    blocks = math.ceil(max(displaced_cells(view, "motion"), turned) / BLOCK_CELLS)
    physics.pose_blocks = min(max(blocks, MIN_BLOCKS), MAX_BLOCKS)


MOTION = Effect(
    name="motion",
    does="shortens or lengthens ranges and turns the far rows against the near ones",
    needs="velocity and turn rate",
    formula="range shift v R / c; turn omega 2 R / c",
    source="travel time of sound",
    rule="the picture's parts move too far with this and the lesser effects left out",
    cost=Cost.CAST,
    parameters=(
        EffectParameter("motion.linear_mps", "m/s", "velocity of the sonar, map frame"),
        EffectParameter("motion.angular_rps", "rad/s", "turn rate, sonar frame"),
    ),
    decide=decide_motion,
    configure=configure_motion,
)


def decide_doppler(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the chirp's coupling shifts echoes by more than the tolerated part of a row."""
    chirp_ms = view.sonar.pulse_s * 1e3
    reason = f"{_speeds(view)} with a chirp of {chirp_ms:.1f} ms"
    return displacement_result("doppler", view, tolerance, reason)


def configure_doppler(physics: Physics, view: PingPreview) -> None:
    """Give the coupling."""
    physics.doppler_shift_s = doppler_shift_s(view.sonar, view.speed_of_sound_mps)


DOPPLER = Effect(
    name="doppler",
    does="shifts the ranges of what is approached or left",
    needs="velocity, length and bandwidth of the chirp",
    formula="range shift v f T / B",
    source="range-Doppler coupling of a linear chirp",
    rule="the picture's parts move too far with this and the lesser effects left out",
    cost=Cost.FREE,
    parameters=(
        EffectParameter("sonar.pulse_s", "s", "length of the chirp"),
        EffectParameter("motion.linear_mps", "m/s", "velocity of the sonar, map frame"),
    ),
    decide=decide_doppler,
    configure=configure_doppler,
)
