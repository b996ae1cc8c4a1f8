"""Bearing table: an Oculus' beams are uniform in the sine of their bearing, not in angle."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_cells
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if equal angles would put any direction into another beam."""
    half_rad = view.sonar.half_aperture_rad
    place = np.linspace(-1.0, 1.0, view.sonar.beams)
    off = np.abs(np.sin(place * half_rad) - place * math.sin(half_rad)) / view.sonar.sine_pitch
    reason = f"equal angles are off over a fan of {2.0 * math.degrees(half_rad):.0f}°"
    return by_cells(float(off.max()), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Lay the beams by sine."""
    del view
    physics.sine_bearings = True


EFFECT = Effect(
    name="bearing_table",
    does="packs beams closely ahead and widely at the edges",
    needs="aperture",
    formula="asin(sin(half aperture) (2 i / (N - 1) - 1))",
    source="public Oculus recording, to 0.01°",
    rule="equal angles displace any direction by more than the tolerated part of a beam",
    cost=Cost.FREE,
    parameters=(Parameter("sonar.half_aperture_rad", "rad", "bearing of the outermost beams"),),
    decide=decide,
    configure=configure,
)
