"""V8: standing still repeats the speckle, and noise takes from that what its share is."""

from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.homogeneous import Homogeneous
from sonar_sim.validation.statistics import correlation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATIOS_DB = (-10.0, -5.0, 0.0, 5.0, 10.0, 15.0)
ROWS = 400


def v08_ping_correlation() -> CaseResult:
    """Correlation of two pings from one pose against the ratio of signal to noise."""
    sheet = Homogeneous(SonarSettings(), ROWS, seed=2)
    checks = [
        Check(f"power at {ratio_db:+g} dB", _model(ratio_db), _found(sheet, ratio_db)[0], 0.025)
        for ratio_db in RATIOS_DB
    ]
    loud, _ = _found(sheet, 20.0)
    silent = [sheet.beams(ping_id, -200.0, 0.0) for ping_id in (1, 2)]
    noise = correlation(np.abs(silent[0]), np.abs(silent[1]))
    checks += [
        Check("above 0.95 at 20 dB", 1.0, loud, 0.05),
        Check("noise alone, below 0.05", 0.0, noise, 0.05),
    ]
    amplitude_less = [np.subtract(*_found(sheet, ratio_db)) for ratio_db in RATIOS_DB]
    checks.append(
        Check("amplitude's less than power's", 0.0, float(np.abs(amplitude_less).max()), 0.03)
    )
    return CaseResult("V8 ping to ping", "(S / (S + N))²", tuple(checks), _draw)


def _model(ratio_db: float) -> float:
    ratio = 10.0 ** (ratio_db / 10.0)
    return float((ratio / (1.0 + ratio)) ** 2)


def _found(sheet: Homogeneous, ratio_db: float) -> tuple[float, float]:
    """Correlation of power and of amplitude."""
    one, other = (np.abs(sheet.beams(ping_id, 0.0, -ratio_db)) for ping_id in (1, 2))
    return correlation(np.square(one), np.square(other)), correlation(one, other)


def _draw(axes: "Axes") -> None:
    sheet = Homogeneous(SonarSettings(), ROWS, seed=2)
    ratios_db = np.linspace(-15.0, 30.0, 60)
    axes.plot(ratios_db, [_model(float(r)) for r in ratios_db], lw=1.0, label="(S / (S + N))²")
    some_db = np.linspace(-15.0, 30.0, 10)
    axes.plot(some_db, [_found(sheet, float(r))[0] for r in some_db], "k+", label="simulated")
    axes.set_xlabel("signal to noise, dB")
    axes.set_ylabel("correlation of two pings")
    axes.legend(fontsize=6)
