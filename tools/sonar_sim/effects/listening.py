"""How sonar and objects move while a ping listens."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.view import View

STEP_S = 1e-3
"""Of the difference that gives an object's velocity."""


def closing_mps(view: View) -> NDArray[np.float64]:
    """Speed with which sonar and each echo approach each other, (N,)."""
    away = view.echoes.point_m - view.map_T_sonar.position_m
    away /= np.maximum(view.echoes.range_m, STEP_S)[:, None]
    own = np.zeros(3) if view.motion is None else np.asarray(view.motion.linear_mps)
    velocity = np.broadcast_to(own, away.shape).copy()
    for number, surface in enumerate(view.scene.surfaces):
        if surface.motion is not None:
            now, soon = (surface.motion.pose(view.time_s + after) for after in (0.0, STEP_S))
            its = view.echoes.surface == number
            velocity[its] -= (soon.position_m - now.position_m) / STEP_S
    closing: NDArray[np.float64] = np.sum(velocity * away, axis=1)
    return closing


def fastest_mps(view: View) -> float:
    """Largest closing or parting speed of anything heard."""
    return float(np.abs(closing_mps(view)).max(initial=0.0))


def turn_rps(view: View) -> float:
    """Rate of turn, rad/s."""
    return 0.0 if view.motion is None else float(np.linalg.norm(view.motion.angular_rps))
