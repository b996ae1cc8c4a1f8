"""Validation of speckle: statistics in a ping and between pings (V7, V8, V9)."""

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import Homogeneous
from sonar_sim.validation.statistics import RAYLEIGH, Speckle, correlation, speckle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPECKLE_ROWS = 9000
APART = (3, 10)
"""Rows and beams between cells that share next to no speckle: 10^5 of them are independent."""
TOLERANCE = Speckle(0.005, 0.03, 0.12, 0.006, 0.003, 3e-4, 0.015, 0.06, 0.03, 0.01)
"""The reference's for CV and distance; else four standard errors of 10^5 cells."""
GAMMA_CV = ((0.25, 0.1484), (0.5, 0.2805), (0.75, 0.4039), (1.0, 0.5227), (1.5, 0.7575), (2.0, 1.0))
LOOKS = (4, 16)


def v07_speckle() -> ValidationResult:
    """Moments, tails, distance to Rayleigh; powers of the amplitude; averages of looks."""
    sample = _independent()
    found = speckle(sample)
    checks = [
        ValidationCheck(
            f.name, getattr(RAYLEIGH, f.name), getattr(found, f.name), getattr(TOLERANCE, f.name)
        )
        for f in fields(Speckle)
    ]
    for exponent, expected in GAMMA_CV:
        raised = sample**exponent
        cv = float(raised.std() / raised.mean())
        checks.append(
            ValidationCheck(f"CV of amplitude^{exponent:g}", expected, cv, 0.012 * exponent)
        )
    for looks in LOOKS:
        power = np.square(sample[: len(sample) // looks * looks]).reshape(-1, looks).mean(axis=1)
        cv = float(power.std() / power.mean())
        checks.append(ValidationCheck(f"CV of {looks} looks' power", looks**-0.5, cv, 0.02))
    return ValidationResult("V7 speckle", "complex Gaussian field", tuple(checks), _draw_speckle)


def _independent() -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    beams = np.abs(Homogeneous(SonarSettings(), SPECKLE_ROWS, seed=1).beams())
    return beams[:: APART[0], :: APART[1]].astype(np.float64).ravel()


def _draw_speckle(axes: "Axes") -> None:
    sample = _independent()
    sample /= np.sqrt(np.mean(np.square(sample)))
    a = np.linspace(0.0, 3.2, 200)
    axes.hist(sample, bins=80, range=(0.0, 3.2), density=True, color="0.8", label="simulated")
    axes.plot(a, 2.0 * a * np.exp(-np.square(a)), lw=1.0, label="Rayleigh")
    axes.set_xlabel("amplitude over rms")
    axes.set_ylabel("density")
    axes.legend(fontsize=6)


RATIOS_DB = (-10.0, -5.0, 0.0, 5.0, 10.0, 15.0)
PING_CORRELATION_ROWS = 400


def v08_ping_correlation() -> ValidationResult:
    """Correlation of two pings from one pose against the ratio of signal to noise."""
    sheet = Homogeneous(SonarSettings(), PING_CORRELATION_ROWS, seed=2)
    checks = [
        ValidationCheck(
            f"power at {ratio_db:+g} dB", _model(ratio_db), _found(sheet, ratio_db)[0], 0.025
        )
        for ratio_db in RATIOS_DB
    ]
    loud, _ = _found(sheet, 20.0)
    silent = [sheet.beams(ping_id, -200.0, 0.0) for ping_id in (1, 2)]
    noise = correlation(np.abs(silent[0]), np.abs(silent[1]))
    checks += [
        ValidationCheck("above 0.95 at 20 dB", 1.0, loud, 0.05),
        ValidationCheck("noise alone, below 0.05", 0.0, noise, 0.05),
    ]
    amplitude_less = [np.subtract(*_found(sheet, ratio_db)) for ratio_db in RATIOS_DB]
    checks.append(
        ValidationCheck(
            "amplitude's less than power's", 0.0, float(np.abs(amplitude_less).max()), 0.03
        )
    )
    return ValidationResult(
        "V8 ping to ping", "(S / (S + N))²", tuple(checks), _draw_ping_correlation
    )


def _model(ratio_db: float) -> float:
    ratio = 10.0 ** (ratio_db / 10.0)
    return float((ratio / (1.0 + ratio)) ** 2)


def _found(sheet: Homogeneous, ratio_db: float) -> tuple[float, float]:
    """Correlation of power and of amplitude."""
    one, other = (np.abs(sheet.beams(ping_id, 0.0, -ratio_db)) for ping_id in (1, 2))
    return correlation(np.square(one), np.square(other)), correlation(one, other)


def _draw_ping_correlation(axes: "Axes") -> None:
    sheet = Homogeneous(SonarSettings(), PING_CORRELATION_ROWS, seed=2)
    ratios_db = np.linspace(-15.0, 30.0, 60)
    axes.plot(ratios_db, [_model(float(r)) for r in ratios_db], lw=1.0, label="(S / (S + N))²")
    some_db = np.linspace(-15.0, 30.0, 10)
    axes.plot(some_db, [_found(sheet, float(r))[0] for r in some_db], "k+", label="simulated")
    axes.set_xlabel("signal to noise, dB")
    axes.set_ylabel("correlation of two pings")
    axes.legend(fontsize=6)


RECORDED = (0.19, 0.04)
"""Amplitude at lags 1 and 2 of lines of 2.842 mm."""
RANGE_LINES_ROWS = 3000


def v09_range_lines() -> ValidationResult:
    """Correlation of amplitude over lags in range."""
    found = _by_lag(2)
    checks = tuple(
        ValidationCheck(f"amplitude at lag {lag}", expected, got, tolerance)
        for lag, expected, got, tolerance in zip(
            (1, 2), RECORDED, found[1:], (0.02, 0.05), strict=True
        )
    )
    return ValidationResult("V9 range lines", "public recording", checks, _draw_range_lines)


def _by_lag(most: int) -> list[float]:
    amplitude = np.abs(Homogeneous(SonarSettings(), RANGE_LINES_ROWS, seed=3).beams())[:, ::5]
    return [
        correlation(amplitude[: len(amplitude) - lag], amplitude[lag:]) for lag in range(most + 1)
    ]


def _draw_range_lines(axes: "Axes") -> None:
    axes.plot(range(6), _by_lag(5), "o-", lw=1.0, ms=3, label="simulated")
    axes.plot((1, 2), RECORDED, "k+", ms=8, label="recorded")
    axes.set_xlabel("lag, range lines")
    axes.set_ylabel("correlation of amplitude")
    axes.legend(fontsize=6)
