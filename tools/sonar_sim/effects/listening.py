"""How sonar and objects move while a ping listens."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.preview import View

STEP_S = 1e-3
"""Of the difference that gives an object's velocity."""


def leaving_mps(view: View) -> NDArray[np.float64]:
    """Velocity of what each echo came from, map frame, (N, 3)."""
    velocity = np.zeros((len(view.echoes.range_m), 3))
    for number, surface in enumerate(view.scene.surfaces):
        if surface.motion is not None:
            now, soon = (surface.motion.pose(view.time_s + after) for after in (0.0, STEP_S))
            its = view.echoes.surface == number
            velocity[its] = (soon.position_m - now.position_m) / STEP_S
    return velocity


def speed_mps(view: View) -> float:
    """Of the sonar."""
    return 0.0 if view.motion is None else float(np.linalg.norm(view.motion.linear_mps))


def turn_rps(view: View) -> float:
    """Rate of turn, rad/s."""
    return 0.0 if view.motion is None else float(np.linalg.norm(view.motion.angular_rps))
