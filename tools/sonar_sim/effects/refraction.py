"""Refraction: sound bends towards slower water, so echoes come from elsewhere than it seems."""

import math

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.bending import bending
from sonar_sim.effects.echoes import GRAZING
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.movers import move_verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level, displaced_db
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Layers, Physics
from sonar_sim.raycast.fan import CENTRE_SINE, ELEVATIONS
from sonar_sim.tolerance import Tolerance

RAY_RAD = 2.0 * CENTRE_SINE / ELEVATIONS
"""Between rays of a column, on the fan's plane: what is as narrow is hit or passed by, and a flash
comes or goes, if paths turn by as much."""
MOST_TURN = 0.3
"""rad; a steeper bend is beyond the rule's small angles, and called for anyway."""


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the bend changes incidence and pattern, or the profile's speeds move echoes."""
    gradient = view.scene.water.largest_gradient_per_s
    if gradient == 0.0 or len(view.echoes.range_m) == 0:
        return Verdict(
            on=False, reason="the speed of sound does not change with depth", predicted_db=0.0
        )
    turn = bending(view).turn_rad
    largest = float(np.abs(turn).max(initial=0.0))
    reason = (
        f"largest gradient {gradient:.2g} /s, paths leave up to {math.degrees(largest):.2g}° off"
    )
    if largest > MOST_TURN:
        return Verdict(on=True, reason=reason, predicted_db=40.0)
    passed_by = largest / RAY_RAD
    if passed_by > tolerance.cells:
        return Verdict(on=True, reason=reason, predicted_db=displaced_db(passed_by))
    level = by_level(
        view.change_of_echoes_db(_bent_power(view, turn), tolerance), tolerance, reason
    )
    moved = move_verdict("refraction", view, tolerance, reason)
    return moved if moved.on and not level.on else level


def _bent_power(view: View, turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
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


def configure(physics: Physics, view: View) -> None:
    """Give the profile."""
    profile = view.scene.water.profile
    if profile is not None:
        depth_m, speed_mps = np.array(profile, dtype=np.float64).T
        physics.layers = Layers(np.ascontiguousarray(depth_m), np.ascontiguousarray(speed_mps))


EFFECT = Effect(
    name="refraction",
    does="bends paths: other incidence, other part of the vertical pattern, moved echoes",
    needs="a profile of sound speed",
    formula="curvature g cos(elevation) / c, half of it at each end; range by mean c0 / c",
    source="Snell's law in a constant gradient",
    rule="paths turn by the tolerated part of the rays' distance, or levels or ranges change more",
    cost=Cost.RAY,
    parameters=(Parameter("water.profile", "m, m/s", "speed of sound over depth"),),
    decide=decide,
    configure=configure,
)
