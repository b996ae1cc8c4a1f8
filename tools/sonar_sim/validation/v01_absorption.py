"""V1: absorption by both formulas, at both bands of an M750d."""

from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.water import Water
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FREQUENCIES_HZ = (750e3, 1200e3)
TABLE = (
    ((4.0, 35.0, 10.0, 8.0), (0.2570, 0.6112), (0.2676, 0.6383)),
    ((10.0, 35.0, 10.0, 8.0), (0.2223, 0.4952), (0.2382, 0.5352)),
    ((15.0, 35.0, 10.0, 8.0), (0.2139, 0.4423), (0.2280, 0.4753)),
    ((20.0, 35.0, 10.0, 8.0), (0.2187, 0.4135), (0.2318, 0.4387)),
    ((25.0, 35.0, 10.0, 8.0), (0.2366, 0.4077), (0.2510, 0.4262)),
    ((10.0, 0.0, 1.0, 7.0), (0.1748, 0.4475), (0.1903, 0.4872)),
    ((20.0, 0.0, 1.0, 7.0), (0.1238, 0.3169), (0.1314, 0.3364)),
    ((10.0, 35.0, 1000.0, 8.0), (0.2091, 0.4718), (0.2202, 0.5004)),
)
"""Temperature, salinity, depth and acidity; dB/m by Francois and Garrison, and by Ainslie."""
OVER_FREQUENCY = ((50e3, 100.0, 15.18e-3), (100e3, 0.0, 33.63e-3), (1000e3, 0.0, 358.6e-3))
"""Frequency, depth, dB/m at 10 °C and 35 ppt."""
PEER = (700e3, Water(20.0, 35.0, 1.0, 8.1), 0.2146)
"""Another simulator's own test of Ainslie and McColm's formula; it allows 3 %."""
RELATIVE = 1e-3


def v01_absorption() -> CaseResult:
    """Work out the table."""
    checks = [*_table(), *_over_frequency()]
    frequency_hz, water, expected = PEER
    got = water.ainslie_mccolm_db_per_m(frequency_hz)
    checks.append(Check("AM 700 kHz, dB/m", expected, got, RELATIVE * expected))
    return CaseResult(
        "V1 absorption",
        "Francois and Garrison 1982, Ainslie and McColm 1998",
        tuple(checks),
        _draw,
    )


def _table() -> list[Check]:
    """Half a unit of the last digit is what the table itself leaves open."""
    checks = []
    for conditions, francois_garrison, ainslie_mccolm in TABLE:
        water = Water(*conditions)
        of = "T {:g} S {:g} D {:g} pH {:g}".format(*conditions)
        for f_hz, fg, am in zip(FREQUENCIES_HZ, francois_garrison, ainslie_mccolm, strict=True):
            for label, expected, got in (
                ("FG", fg, water.francois_garrison_db_per_m(f_hz)),
                ("AM", am, water.ainslie_mccolm_db_per_m(f_hz)),
            ):
                what = f"{label} {f_hz / 1e3:g} kHz {of}, dB/m"
                checks.append(Check(what, expected, got, RELATIVE * expected))
    return checks


def _over_frequency() -> list[Check]:
    return [
        Check(
            f"FG {f_hz / 1e3:g} kHz D {depth_m:g}, dB/m",
            expected,
            Water(depth_m=depth_m).francois_garrison_db_per_m(f_hz),
            RELATIVE * expected,
        )
        for f_hz, depth_m, expected in OVER_FREQUENCY
    ]


def _draw(axes: "Axes") -> None:
    frequency_hz = np.geomspace(50e3, 3e6, 60)
    for name, water in (("sea, 10 °C", Water()), ("fresh, 20 °C", Water(20.0, 0.0, 1.0, 7.0))):
        by = {
            "FG": [water.francois_garrison_db_per_m(f) for f in frequency_hz],
            "AM": [water.ainslie_mccolm_db_per_m(f) for f in frequency_hz],
        }
        (line,) = axes.loglog(frequency_hz / 1e3, by["FG"], label=f"FG {name}")
        axes.loglog(frequency_hz / 1e3, by["AM"], "--", color=line.get_color(), label=f"AM {name}")
    for f_hz, fg in zip(FREQUENCIES_HZ, TABLE[1][1], strict=True):
        axes.plot(f_hz / 1e3, fg, "k.", markersize=8)
    axes.set_xlabel("frequency, kHz")
    axes.set_ylabel("dB/m, one way")
    axes.legend(fontsize=7)
