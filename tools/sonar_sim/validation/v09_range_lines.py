"""V9: neighbouring range lines share as much speckle as recorded ones do."""

from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.homogeneous import Homogeneous
from sonar_sim.validation.statistics import correlation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RECORDED = (0.19, 0.04)
"""Amplitude at lags 1 and 2 of lines of 2.842 mm."""
ROWS = 3000


def v09_range_lines() -> CaseResult:
    """Correlation of amplitude over lags in range."""
    found = _by_lag(2)
    checks = tuple(
        Check(f"amplitude at lag {lag}", expected, got, tolerance)
        for lag, expected, got, tolerance in zip(
            (1, 2), RECORDED, found[1:], (0.02, 0.05), strict=True
        )
    )
    return CaseResult("V9 range lines", "public recording", checks, _draw)


def _by_lag(most: int) -> list[float]:
    amplitude = np.abs(Homogeneous(SonarSettings(), ROWS, seed=3).beams())[:, ::5]
    return [
        correlation(amplitude[: len(amplitude) - lag], amplitude[lag:]) for lag in range(most + 1)
    ]


def _draw(axes: "Axes") -> None:
    axes.plot(range(6), _by_lag(5), "o-", lw=1.0, ms=3, label="simulated")
    axes.plot((1, 2), RECORDED, "k+", ms=8, label="recorded")
    axes.set_xlabel("lag, range lines")
    axes.set_ylabel("correlation of amplitude")
    axes.legend(fontsize=6)
