"""V7: speckle of an even surface is Rayleigh's."""

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.homogeneous import Homogeneous
from sonar_sim.validation.statistics import RAYLEIGH, Speckle, speckle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROWS = 9000
APART = (3, 10)
"""Rows and beams between cells that share next to no speckle: 10^5 of them are independent."""
TOLERANCE = Speckle(0.005, 0.03, 0.12, 0.006, 0.003, 3e-4, 0.015, 0.06, 0.03, 0.01)
"""The reference's for CV and distance; else four standard errors of 10^5 cells."""
GAMMA_CV = ((0.25, 0.1484), (0.5, 0.2805), (0.75, 0.4039), (1.0, 0.5227), (1.5, 0.7575), (2.0, 1.0))
LOOKS = (4, 16)


def v07_speckle() -> CaseResult:
    """Moments, tails, distance to Rayleigh; powers of the amplitude; averages of looks."""
    sample = _independent()
    found = speckle(sample)
    checks = [
        Check(f.name, getattr(RAYLEIGH, f.name), getattr(found, f.name), getattr(TOLERANCE, f.name))
        for f in fields(Speckle)
    ]
    for exponent, expected in GAMMA_CV:
        raised = sample**exponent
        cv = float(raised.std() / raised.mean())
        checks.append(Check(f"CV of amplitude^{exponent:g}", expected, cv, 0.012 * exponent))
    for looks in LOOKS:
        power = np.square(sample[: len(sample) // looks * looks]).reshape(-1, looks).mean(axis=1)
        cv = float(power.std() / power.mean())
        checks.append(Check(f"CV of {looks} looks' power", looks**-0.5, cv, 0.02))
    return CaseResult("V7 speckle", "complex Gaussian field", tuple(checks), _draw)


def _independent() -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    beams = np.abs(Homogeneous(SonarSettings(), ROWS, seed=1).beams())
    return beams[:: APART[0], :: APART[1]].astype(np.float64).ravel()


def _draw(axes: "Axes") -> None:
    sample = _independent()
    sample /= np.sqrt(np.mean(np.square(sample)))
    a = np.linspace(0.0, 3.2, 200)
    axes.hist(sample, bins=80, range=(0.0, 3.2), density=True, color="0.8", label="simulated")
    axes.plot(a, 2.0 * a * np.exp(-np.square(a)), lw=1.0, label="Rayleigh")
    axes.set_xlabel("amplitude over rms")
    axes.set_ylabel("density")
    axes.legend(fontsize=6)
