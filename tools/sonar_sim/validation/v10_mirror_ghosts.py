"""V10: ghosts of a target under a calm surface."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.propagation.physics import Mirror
from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import MEAN, narrow_sonar, pose_at, target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLE = (
    (2.0, 2.0, 10.0, 10.0000, 10.3852, 10.7703),
    (1.0, 3.0, 5.0, 5.3852, 5.8941, 6.4031),
    (5.0, 5.0, 20.0, 20.0000, 21.1803, 22.3607),
    (0.5, 1.5, 8.0, 8.0623, 8.1542, 8.2462),
)
"""Depths of sonar and target, distance; ranges of the echo and its two ghosts, m."""
REFLECTION = -0.9
ROW_M = 0.004
SURFACE = Mirror(np.zeros(3), np.array([0.0, 0.0, -1.0]), REFLECTION)
PHYSICS = dataclasses.replace(MEAN, speckle=True, mirrors=(SURFACE,))


def v10_mirror_ghosts() -> CaseResult:
    """Ranges within half a cell; levels against the direct echo; the bearing kept."""
    checks = []
    for sonar_m, target_m, away_m, direct_m, once_m, twice_m in TABLE:
        amplitude = _seen(sonar_m, target_m, away_m)
        rows = np.flatnonzero(amplitude.max(axis=1) > 0.0)
        name = f"{sonar_m:g}, {target_m:g}, {away_m:g} m"
        for row, expected in zip(rows, (direct_m, once_m, twice_m), strict=True):
            got = (row + 0.5) * ROW_M
            checks.append(Check(f"{name}: echo, m", expected, float(got), ROW_M / 2.0 + 1e-4))
        level = 20.0 * np.log10(amplitude.max(axis=1)[rows])
        once_db = 20.0 * math.log10(2.0 * abs(REFLECTION) * direct_m / twice_m)
        twice_db = 20.0 * math.log10(REFLECTION**2 * direct_m**2 / twice_m**2)
        checks.append(Check(f"{name}: ghost A, dB", once_db, float(level[1] - level[0]), 0.05))
        checks.append(Check(f"{name}: ghost B, dB", twice_db, float(level[2] - level[0]), 0.05))
        beams = amplitude.argmax(axis=1)[rows]
        checks.append(Check(f"{name}: beams apart", 0.0, float(np.ptp(beams)), 0.0))
    return CaseResult("V10 mirror ghosts", "image sources", tuple(checks), _draw)


def _seen(sonar_m: float, target_m: float, away_m: float) -> NDArray[np.float32]:
    engine = Engine(
        Scene(targets=(target((away_m, 0.0, -target_m)),)), narrow_sonar(24.0, ROW_M, 65)
    )
    return engine.ping(pose_at((0.0, 0.0, -sonar_m)), PHYSICS).amplitude


def _draw(axes: "Axes") -> None:
    level = 20.0 * np.log10(np.maximum(_seen(*TABLE[0][:3]).max(axis=1), 1e-9))
    axes.plot((np.arange(len(level)) + 0.5) * ROW_M, level - level.max(), lw=0.8)
    for range_m in TABLE[0][3:]:
        axes.axvline(range_m, color="0.6", lw=0.8, ls="--")
    axes.set_xlim(9.8, 11.0)
    axes.set_ylim(-40, 5)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
