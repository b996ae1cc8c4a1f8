"""Vertical pattern: what lies above or below the fan is heard less, twice."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if echoes lie so far off the fan's plane that the picture changes."""
    echoes = view.echoes
    power = view.echo_power / np.maximum(view.pattern, 1e-12)
    low, high = (
        math.degrees(math.asin(v)) for v in (echoes.up.min(initial=0.0), echoes.up.max(initial=0.0))
    )
    reason = f"echoes at {low:.0f} to {high:.0f}° off the fan's plane"
    return by_level(view.change_of_echoes_db(power, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the aperture its width."""
    physics.vertical_width_rad = view.sonar.vertical_width_rad


EFFECT = Effect(
    name="vertical_pattern",
    does="darkens what is above or below the fan; leaves a dark ring at its null",
    needs="elevations",
    formula="sinc²(0.443 sin e / sin(width / 2)) each way, in power",
    source="unshaded aperture",
    rule="the picture without it differs by more than the tolerance",
    cost=Cost.FREE,
    parameters=(Parameter("sonar.vertical_width_rad", "rad", "-3 dB full width, one way"),),
    decide=decide,
    configure=configure,
)
