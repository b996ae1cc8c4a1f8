"""V4: target strength of spheres, mirroring and dull."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.raycast.fan import ELEVATIONS
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    CHALK,
    MEAN,
    MIRROR,
    cell_power,
    decibel,
    narrow_sonar,
    pose_at,
    sphere,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sonar_sim.material import Material

TABLE = (
    (0.05, -32.04, -32.81),
    (0.10, -26.02, -26.79),
    (0.25, -18.06, -18.83),
    (0.50, -12.04, -12.81),
)
"""Radius, strength of a rigid one and of a Lambert one with mu 0.1."""
AWAY = 40.0
"""Range over radius: far enough for the table, whose waves are plane."""
FINE = 1120
"""Rays a column that meet a sphere so far off within a facet of its limb."""
TOLERANCE_DB = 0.3


def v04_spheres() -> CaseResult:
    """Sums over all cells, with each one's own spreading taken off."""
    checks = []
    for radius_m, rigid_db, dull_db in TABLE:
        sonar, power = _seen(radius_m, MIRROR)
        range_m = AWAY * radius_m
        # From a distance d the mirrored wave spreads as if from behind: a²/4 / (d² (d + a)²).
        got = decibel(power.sum() * (range_m - radius_m) ** 2 * range_m**2)
        checks.append(Check(f"rigid, {radius_m:g} m, dB", rigid_db, got, TOLERANCE_DB))
        sonar, power = _seen(radius_m, CHALK)
        got = decibel(float((power.sum(axis=1) * sonar.row_centres_m**4).sum()))
        checks.append(Check(f"Lambert, {radius_m:g} m, dB", dull_db, got, TOLERANCE_DB))
    checks += _extents(*_seen(TABLE[-1][0], CHALK, FINE))
    return CaseResult("V4 spheres", "20 log(a/2); 10 log(2 pi mu a²/3)", tuple(checks), _draw)


def _extents(sonar: SonarSettings, power: NDArray[np.float64]) -> list[Check]:
    """From the nearest point to the limb, and from side to side."""
    radius_m = TABLE[-1][0]
    range_m = AWAY * radius_m
    rows = np.flatnonzero(power.sum(axis=1) > 0.0) * sonar.range_resolution_m
    beams = np.flatnonzero(power.sum(axis=0) > 0.0)
    # A face's plane is followed a face's length beyond what the ray met.
    facet_m = radius_m * math.radians(63.4) / 32.0
    limb_m = math.sqrt(range_m**2 - radius_m**2)
    wide = float(beams[-1] - beams[0] + 1) * sonar.sine_pitch
    return [
        Check("nearest echo, m", range_m - radius_m, float(rows[0]), facet_m),
        Check("limb, m", limb_m, float(rows[-1]), 2.5 * facet_m),
        Check("width in sine", 2.0 * radius_m / range_m, wide, 2.0 * sonar.sine_pitch),
    ]


def _seen(
    radius_m: float, material: "Material", elevations: int = ELEVATIONS
) -> tuple[SonarSettings, NDArray[np.float64]]:
    range_m = AWAY * radius_m
    sonar = narrow_sonar(1.1 * range_m)
    scene = Scene((sphere((range_m, 0.0, 0.0), radius_m, material),))
    engine = Engine(scene, sonar, elevations=elevations)
    return sonar, cell_power(engine, pose_at((0.0, 0.0, 0.0)), MEAN)


def _draw(axes: "Axes") -> None:
    for radius_m, _, _ in TABLE:
        sonar, power = _seen(radius_m, CHALK)
        level = 10.0 * np.log10(np.maximum(power.sum(axis=1), 1e-12))
        axes.plot(sonar.row_centres_m - AWAY * radius_m, level, lw=0.8, label=f"{radius_m:g} m")
    axes.set_xlim(-0.6, 0.1)
    axes.set_ylim(-120, -70)
    axes.set_xlabel("range beyond the centre, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)
