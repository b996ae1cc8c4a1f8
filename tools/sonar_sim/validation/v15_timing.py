"""V15: a ping takes at least as long as the sound is under way."""

import math
from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.geometry.pose import Mounting
from sonar_sim.scenario import Scenario
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import sonar_preset
from sonar_sim.trajectory import Trajectory, Waypoint
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CAPS_HZ = (40.0, 15.0, 10.0, 5.0, 2.0)
RANGES_M = (10.0, 40.0, 120.0)
PERIODS_MS = (13.33, 53.33, 160.0)
"""2 R / c at 1500 m/s."""
SPEED_MPS = 1500.0


def v15_timing() -> CaseResult:
    """Ping period against range, under each cap of the rate."""
    checks = [
        Check(f"period at {range_m:g} m, ms", expected, _period_ms(range_m, math.inf), 0.01)
        for range_m, expected in zip(RANGES_M, PERIODS_MS, strict=True)
    ]
    checks += [
        Check(f"rate at 1 m under a cap of {cap:g} Hz, Hz", cap, 1e3 / _period_ms(1.0, cap), 1e-9)
        for cap in CAPS_HZ
    ]
    return CaseResult("V15 timing", "2 R / c; caps of the fire message", tuple(checks), _draw)


def _period_ms(range_m: float, cap_hz: float) -> float:
    """Time from ping to ping of a survey, as if sound went at 1500 m/s."""
    scene = Scene()
    scenario = Scenario(
        "timing",
        scene,
        sonar_preset("M750d", demanded_range_m=range_m, forced_rows=500),
        mounting=Mounting(),
        trajectory=Trajectory([Waypoint(0.0, 0.0, -2.0, 0.0), Waypoint(1.0, 0.0, -2.0, 0.0)]),
        ping_rate_hz=cap_hz,
    )
    period_ms = 1e3 / scenario.true_ping_rate_hz
    if scenario.true_ping_rate_hz == cap_hz:
        return period_ms
    return period_ms * scene.water.speed_of_sound_mps / SPEED_MPS


def _draw(axes: "Axes") -> None:
    ranges_m = np.geomspace(1.0, 120.0, 40)
    for cap_hz in (math.inf, *CAPS_HZ):
        periods = [_period_ms(float(range_m), cap_hz) for range_m in ranges_m]
        axes.loglog(
            ranges_m,
            periods,
            lw=1.0,
            label=f"cap {cap_hz:g} Hz" if math.isfinite(cap_hz) else "no cap",
        )
    axes.loglog(RANGES_M, PERIODS_MS, "k+", ms=8, label="2 R / c")
    axes.set_xlabel("range, m")
    axes.set_ylabel("ping period, ms")
    axes.legend(fontsize=6)
