"""V5: a plate as a mirror, and a dull one whatever its triangles and rays."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.raycast.fan import ELEVATIONS
from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    DULL,
    MEAN,
    MIRROR,
    cell_power,
    decibel,
    narrow_sonar,
    pose_at,
    rectangle,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sonar_sim.material import Material

RANGES_M = (0.5, 1.0, 2.0, 5.0, 10.0)
CUTS = (1, 2, 4, 8)
"""2, 8, 32 and 128 triangles."""
SPECKLED = dataclasses.replace(MEAN, speckle=True)


def v05_plate() -> CaseResult:
    """0.5 m by 0.6 m: the mirror law near by, and invariance of the dull plate."""
    checks = [
        Check(f"mirror at {r:g} m, dB", 20.0 * math.log10(r / 2.0), _mirror_db(r), 0.3)
        for r in RANGES_M
    ]
    whole = decibel(_dull(1).sum())
    checks += [
        Check(f"{2 * cuts**2} triangles, dB", whole, decibel(_dull(cuts).sum()), 0.05)
        for cuts in CUTS[1:]
    ]
    checks.append(Check("twice the rays, dB", whole, decibel(_dull(1, rays=2).sum()), 0.1))
    area_db = decibel(DULL.mu * 0.3 / 5.0**4)
    checks.append(Check("mu A / R⁴, dB", area_db, whole, 0.1))
    same = np.abs(_speckled(1) - _speckled(8)).max() / _speckled(1).max()
    checks.append(Check("speckle of 2 and 128 triangles, of its peak", 0.0, float(same), 1e-3))
    return CaseResult("V5 plate", "mirror law R²/4; sums of mu cos² dA", tuple(checks), _draw)


def _mirror_db(range_m: float) -> float:
    return decibel(_seen(range_m, MIRROR, 1, 1).sum() * range_m**4)


def _dull(cuts: int, rays: int = 1) -> NDArray[np.float64]:
    return _seen(5.0, DULL, cuts, rays)


def _seen(range_m: float, material: "Material", cuts: int, rays: int) -> NDArray[np.float64]:
    plate = rectangle((range_m, 0, 0), (0, 0.5, 0), (0, 0, 0.6), material, cuts)
    engine = Engine(Scene((plate,)), narrow_sonar(1.1 * range_m), elevations=ELEVATIONS * rays)
    return cell_power(engine, pose_at((0.0, 0.0, 0.0)), MEAN)


def _speckled(cuts: int) -> NDArray[np.float32]:
    """A plate askew, so that its echo has many rows."""
    plate = rectangle((5.0, 0, 0), (0.3, 0.4, 0), (0.3, 0, 0.5), DULL, cuts)
    engine = Engine(Scene((plate,)), narrow_sonar(6.0))
    return engine.ping(pose_at((0.0, 0.0, 0.0)), SPECKLED).amplitude


def _draw(axes: "Axes") -> None:
    ranges = np.linspace(2.0, 12.0, 11)
    axes.plot(ranges, 20.0 * np.log10(ranges / 2.0), lw=0.8, label="mirror law")
    axes.plot(ranges, [_mirror_db(r) for r in ranges], "o", ms=3, label="simulated")
    axes.set_xlabel("range, m")
    axes.set_ylabel("target strength, dB")
    axes.legend(fontsize=6)
