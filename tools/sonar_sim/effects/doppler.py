"""Doppler: a shifted chirp looks like one that comes from another range."""

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.listening import speed_mps
from sonar_sim.effects.movers import doppler_shift_s, move_verdict
from sonar_sim.effects.preview import View
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the chirp's coupling shifts echoes by more than the tolerated part of a row."""
    chirp_ms = view.sonar.pulse_s * 1e3
    reason = f"{speed_mps(view):.2f} m/s with a chirp of {chirp_ms:.1f} ms"
    return move_verdict("doppler", view, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the coupling."""
    physics.doppler_shift_s = doppler_shift_s(view.sonar, view.speed_mps)


EFFECT = Effect(
    name="doppler",
    does="shifts the ranges of what is approached or left",
    needs="velocity, length and bandwidth of the chirp",
    formula="range shift v f T / B",
    source="range-Doppler coupling of a linear chirp",
    rule="the picture's parts move too far with this and the lesser movers left out",
    cost=Cost.FREE,
    parameters=(
        Parameter("sonar.pulse_s", "s", "length of the chirp"),
        Parameter("motion.linear_mps", "m/s", "velocity of the sonar, map frame"),
    ),
    decide=decide,
    configure=configure,
)
