"""Motion within the ping: the sonar has moved on when the far echoes come back."""

import math

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.listening import speed_mps, turn_rps
from sonar_sim.effects.movers import move_verdict, moved_cells
from sonar_sim.effects.preview import View
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance

LEAST_BLOCKS, MOST_BLOCKS = 4, 16
BLOCK_CELLS = 0.25
"""Motion within a block of rows, at most, until there are `MOST_BLOCKS`."""


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if range shifts or the picture turns by more than the tolerated part of a cell."""
    speed, turn = speed_mps(view), math.degrees(turn_rps(view))
    reason = f"{speed:.2f} m/s, {turn:.1f}°/s, echoes to {view.far_m:.0f} m"
    return move_verdict("motion", view, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the ping as many poses as keep the motion within each small."""
    blocks = math.ceil(moved_cells(view, "motion") / BLOCK_CELLS)
    physics.pose_blocks = min(max(blocks, LEAST_BLOCKS), MOST_BLOCKS)


EFFECT = Effect(
    name="motion",
    does="shortens or lengthens ranges and turns the far rows against the near ones",
    needs="velocity and turn rate",
    formula="range shift v R / c; turn omega 2 R / c",
    source="travel time of sound",
    rule="the picture's parts move too far with this and the lesser movers left out",
    cost=Cost.CAST,
    parameters=(
        Parameter("motion.linear_mps", "m/s", "velocity of the sonar, map frame"),
        Parameter("motion.angular_rps", "rad/s", "turn rate, sonar frame"),
    ),
    decide=decide,
    configure=configure,
)
