"""Sound speed: a sonar told a wrong speed shows everything at a wrong range."""

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.movers import move_verdict, range_scale
from sonar_sim.effects.preview import View
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the farthest echo moves by more than the tolerated part of a row."""
    told_mps = view.sonar.told_speed_mps or view.speed_mps
    reason = f"told {told_mps:.1f} m/s, true {view.speed_mps:.1f} m/s, echoes to {view.far_m:.1f} m"
    return move_verdict("sound_speed", view, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Scale the apparent ranges."""
    physics.range_scale = range_scale(view)


EFFECT = Effect(
    name="sound_speed",
    does="shifts ranges by the error of the speed the sonar reckons with",
    needs="true and told speed of sound",
    formula="dR / R = dc / c; c by Medwin 1975 or the profile",
    source="Medwin 1975",
    rule="the picture's parts move too far with this and the lesser movers left out",
    cost=Cost.FREE,
    parameters=(
        Parameter(
            "sonar.told_speed_mps", "m/s", "speed the sonar reckons with; none: the true one"
        ),
        Parameter("water.profile", "m, m/s", "speed over depth"),
    ),
    decide=decide,
    configure=configure,
)
