"""V13: bearings follow the sine."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.beams import beam_sines
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLES = (
    (256, 30.0, (-30.00, -29.74), 0.11),
    (512, 65.0, (-65.00, -64.52), 0.10),
)
"""Beams, half aperture deg, first two bearings deg, either side of the middle deg."""


def v13_bearings() -> CaseResult:
    """Ends and middle of two fans, and the equal angles that the law is not."""
    checks = []
    for beams, half_deg, first_deg, middle_deg in TABLES:
        found = bearings_deg(beams, half_deg)
        name = f"{beams} beams, {2 * half_deg:g} deg"
        expected = (*first_deg, -middle_deg, middle_deg)
        got = (*found[:2], *found[beams // 2 - 1 : beams // 2 + 1])
        checks += [
            Check(f"{name}: beam {i}, deg", want, float(have), 0.01)
            for i, want, have in zip((0, 1, "-", "+"), expected, got, strict=True)
        ]
    gap = np.abs(bearings_deg(512, 65.0) - bearings_deg(512, 65.0, sine=False)).max()
    checks.append(Check("equal angles are off by, deg", 6.2, float(gap), 0.05))
    return CaseResult("V13 bearings", "recording; asin of equal steps", tuple(checks), _draw)


def bearings_deg(beams: int, half_deg: float, *, sine: bool = True) -> NDArray[np.float64]:
    """Bearing of each beam of a fan."""
    sonar = dataclasses.replace(
        SonarSettings(), beams=beams, half_aperture_rad=math.radians(half_deg)
    )
    return np.degrees(np.arcsin(beam_sines(sonar, Physics(sine_bearings=sine))))


def _draw(axes: "Axes") -> None:
    for sine, label in ((True, "uniform in sine"), (False, "equal angles")):
        axes.plot(np.diff(bearings_deg(512, 65.0, sine=sine)), lw=1.0, label=label)
    axes.set_xlabel("beam of 512 over 130 deg")
    axes.set_ylabel("spacing, deg")
    axes.legend(fontsize=6)
