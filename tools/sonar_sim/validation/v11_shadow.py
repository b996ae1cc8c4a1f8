"""V11: the shadow of a wall on a floor."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    MEAN,
    cell_power,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SONAR_M, WALL_M, AWAY_M = 3.0, 0.5, 10.0
END_M = AWAY_M * SONAR_M / (SONAR_M - WALL_M)
ROW_M = 0.01


def v11_shadow() -> CaseResult:
    """From the wall's foot to where the ray over its top meets the floor."""
    middle = _middle()
    range_m = (np.arange(len(middle)) + 0.5) * ROW_M
    foot_m = float(np.hypot(AWAY_M, SONAR_M))
    dark = np.flatnonzero((middle == 0.0) & (range_m > AWAY_M))
    end_m = range_m[dark[range_m[dark] < float(np.hypot(END_M, SONAR_M)) + 0.3][-1]]
    inside = middle[(range_m > foot_m + 0.1) & (range_m < end_m - 0.1)]
    checks = (
        Check("darkness begins, slant m", foot_m, float(range_m[dark[0]]), 0.03),
        Check("darkness ends, slant m", float(np.hypot(END_M, SONAR_M)), float(end_m), 0.08),
        Check("power in the dark", 0.0, float(inside.max()), 0.0),
    )
    return CaseResult("V11 shadow", "similar triangles: x hs / (hs - H)", checks, _draw)


def _middle() -> NDArray[np.float64]:
    wall = rectangle((AWAY_M, 0.0, WALL_M / 2.0), (0.0, 40.0, 0.0), (0.0, 0.0, WALL_M))
    engine = Engine(Scene((floor(), wall)), narrow_sonar(16.0, ROW_M))
    power = cell_power(engine, pose_at((0.0, 0.0, SONAR_M)), MEAN)
    middle = power.shape[1] // 2
    mean: NDArray[np.float64] = power[:, middle - 1 : middle + 1].mean(axis=1)
    return mean


def _draw(axes: "Axes") -> None:
    middle = _middle()
    level = 10.0 * np.log10(np.maximum(middle, 1e-20))
    axes.plot((np.arange(len(level)) + 0.5) * ROW_M, level, lw=0.8)
    for distance_m in (AWAY_M, END_M):
        axes.axvline(float(np.hypot(distance_m, SONAR_M)), color="0.6", lw=0.8, ls="--")
    axes.set_xlim(9, 14)
    axes.set_ylim(-140, -80)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
