"""How a profile of the speed of sound bends and stretches the paths to the echoes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.preview import View

STEPS = 8
"""Places along a path at which the profile is read."""
HALF_STEP_M = 0.05
"""Depth over which a gradient is taken, each way."""


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """What the profile does to each echo's path, (N,) each.

    Attributes:
        turn_rad: how much steeper down the path leaves than the straight line to its echo.
        stretch: apparent range over true range, by the mean slowness along the straight line.
    """

    turn_rad: NDArray[np.float64]
    stretch: NDArray[np.float64]


def bending(view: View) -> Bending:
    """Follow the straight paths through the profile.

    In a constant gradient g a path is an arc of curvature g cos / c, whose chord leaves it by half
    of the bend: g R cos / (2 c). The gradient is the mean one between sonar and echo, weighted as
    the arc sees it: the end of the path is reached by (1 - t) of what bends at t.
    """
    profile, echoes = view.scene.water.profile, view.echoes
    if profile is None:
        return Bending(np.zeros(len(echoes.range_m)), np.ones(len(echoes.range_m)))
    depths_m, speeds_mps = np.array(profile, dtype=np.float64).T
    steps = (np.arange(STEPS) + 0.5) / STEPS
    depth_s = -float(view.map_T_sonar.position_m[2])
    along_m = depth_s + np.outer(-echoes.point_m[:, 2] - depth_s, steps)
    below, above = (
        np.interp(along_m + off, depths_m, speeds_mps) for off in (HALF_STEP_M, -HALF_STEP_M)
    )
    mean = ((below - above) / (2.0 * HALF_STEP_M) * (1.0 - steps)).mean(axis=1) * 2.0
    level_m = np.hypot(*(echoes.point_m - view.map_T_sonar.position_m)[:, :2].T)
    speed = np.interp(along_m, depths_m, speeds_mps)
    return Bending(-mean * level_m / (2.0 * view.speed_mps), (view.speed_mps / speed).mean(axis=1))
