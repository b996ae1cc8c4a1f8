"""V2: how echoes fall with range, absorption apart."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    MEAN,
    MIRROR,
    centre_row_mean,
    decibel,
    floor,
    narrow_sonar,
    pose_at,
    power_of,
    rectangle,
    target,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RANGES_M = (4.0, 8.0, 16.0, 40.0)
GRAZING = 0.2
"""Sine of the grazing angle that is kept."""
TOLERANCE = 0.2


def v02_range_slopes() -> CaseResult:
    """Slopes in dB a decade, fitted over a decade."""
    checks = tuple(
        Check(f"{name}, dB/decade", expected, _slope(levels()), TOLERANCE)
        for name, expected, levels in CURVES
    )
    return CaseResult("V2 range slopes", "spreading laws", checks, _draw)


def _slope(levels_db: list[float]) -> float:
    return float(np.polyfit(np.log10(RANGES_M), levels_db, 1)[0])


def _target() -> list[float]:
    sonar = narrow_sonar(42.0, 0.02)
    scenes = [Scene(targets=(target((r, 0.0, 0.0)),)) for r in RANGES_M]
    return [decibel(power_of(s, sonar, pose_at((0.0, 0.0, 0.0))).sum()) for s in scenes]


def _mirror() -> list[float]:
    sonar = narrow_sonar(42.0, 0.02)
    plates = [rectangle((r, 0, 0), (0, 20.0, 0), (0, 0, 20.0), MIRROR) for r in RANGES_M]
    scenes = [Scene((plate,)) for plate in plates]
    return [decibel(power_of(s, sonar, pose_at((0.0, 0.0, 0.0))).sum()) for s in scenes]


def _grazing() -> list[float]:
    sonar = narrow_sonar(42.0, 0.02)
    heights = [GRAZING * r for r in RANGES_M]
    powers = [power_of(Scene((floor(),)), sonar, pose_at((0.0, 0.0, h))) for h in heights]
    return [
        decibel(centre_row_mean(power, sonar, r)) for power, r in zip(powers, RANGES_M, strict=True)
    ]


def _floor() -> list[float]:
    sonar = narrow_sonar(42.0, 0.02)
    height_m = 0.2
    power = power_of(Scene((floor(),)), sonar, pose_at((0.0, 0.0, height_m)))
    return [decibel(centre_row_mean(power, sonar, r)) for r in RANGES_M]


def _volume() -> list[float]:
    sonar = narrow_sonar(42.0, 0.02)
    physics = dataclasses.replace(MEAN, volume_strength_db=-60.0)
    power = power_of(Scene(), sonar, pose_at((0.0, 0.0, 0.0)), physics)
    return [decibel(centre_row_mean(power, sonar, r)) for r in RANGES_M]


CURVES: tuple[tuple[str, float, Callable[[], list[float]]], ...] = (
    ("point target", -40.0, _target),
    ("mirror plate", -20.0, _mirror),
    ("Lambert surface at one grazing angle", -30.0, _grazing),
    ("water volume", -20.0, _volume),
    ("Lambert floor", -50.0, _floor),
)


def _draw(axes: "Axes") -> None:
    for name, expected, levels in CURVES:
        found = np.array(levels())
        axes.semilogx(RANGES_M, found - found[0], "o", ms=3, label=name)
        line = expected * np.log10(np.array(RANGES_M) / RANGES_M[0])
        axes.semilogx(RANGES_M, line, "0.6", lw=0.8)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)
