"""Validation of propagation: absorption, range, mirrors, shadows (V1, V2, V10, V11, V17)."""

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import PingEngine
from sonar_sim.propagation.physics import Mirror
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.water import Water
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import (
    MEAN,
    MIRROR,
    cell_power,
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

FREQUENCIES_HZ = (750e3, 1200e3)
ABSORPTION_TABLE = (
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


def v01_absorption() -> ValidationResult:
    """Work out the table."""
    checks = [*_table(), *_over_frequency()]
    frequency_hz, water, expected = PEER
    got = water.ainslie_mccolm_db_per_m(frequency_hz)
    checks.append(ValidationCheck("AM 700 kHz, dB/m", expected, got, RELATIVE * expected))
    return ValidationResult(
        "V1 absorption",
        "Francois and Garrison 1982, Ainslie and McColm 1998",
        tuple(checks),
        _draw_absorption,
    )


def _table() -> list[ValidationCheck]:
    """Half a unit of the last digit is what the table itself leaves open."""
    checks = []
    for conditions, francois_garrison, ainslie_mccolm in ABSORPTION_TABLE:
        water = Water(*conditions)
        of = "T {:g} S {:g} D {:g} pH {:g}".format(*conditions)
        for f_hz, fg, am in zip(FREQUENCIES_HZ, francois_garrison, ainslie_mccolm, strict=True):
            for label, expected, got in (
                ("FG", fg, water.francois_garrison_db_per_m(f_hz)),
                ("AM", am, water.ainslie_mccolm_db_per_m(f_hz)),
            ):
                what = f"{label} {f_hz / 1e3:g} kHz {of}, dB/m"
                checks.append(ValidationCheck(what, expected, got, RELATIVE * expected))
    return checks


def _over_frequency() -> list[ValidationCheck]:
    return [
        ValidationCheck(
            f"FG {f_hz / 1e3:g} kHz D {depth_m:g}, dB/m",
            expected,
            Water(depth_m=depth_m).francois_garrison_db_per_m(f_hz),
            RELATIVE * expected,
        )
        for f_hz, depth_m, expected in OVER_FREQUENCY
    ]


def _draw_absorption(axes: "Axes") -> None:
    frequency_hz = np.geomspace(50e3, 3e6, 60)
    for name, water in (("sea, 10 °C", Water()), ("fresh, 20 °C", Water(20.0, 0.0, 1.0, 7.0))):
        by = {
            "FG": [water.francois_garrison_db_per_m(f) for f in frequency_hz],
            "AM": [water.ainslie_mccolm_db_per_m(f) for f in frequency_hz],
        }
        (line,) = axes.loglog(frequency_hz / 1e3, by["FG"], label=f"FG {name}")
        axes.loglog(frequency_hz / 1e3, by["AM"], "--", color=line.get_color(), label=f"AM {name}")
    for f_hz, fg in zip(FREQUENCIES_HZ, ABSORPTION_TABLE[1][1], strict=True):
        axes.plot(f_hz / 1e3, fg, "k.", markersize=8)
    axes.set_xlabel("frequency, kHz")
    axes.set_ylabel("dB/m, one way")
    axes.legend(fontsize=7)


RANGES_M = (4.0, 8.0, 16.0, 40.0)
GRAZING = 0.2
"""Sine of the grazing angle that is kept."""
TOLERANCE = 0.2


def v02_range_slopes() -> ValidationResult:
    """Slopes in dB a decade, fitted over a decade."""
    checks = tuple(
        ValidationCheck(f"{name}, dB/decade", expected, _slope(levels()), TOLERANCE)
        for name, expected, levels in CURVES
    )
    return ValidationResult("V2 range slopes", "spreading laws", checks, _draw_range_slopes)


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


def _draw_range_slopes(axes: "Axes") -> None:
    for name, expected, levels in CURVES:
        found = np.array(levels())
        axes.semilogx(RANGES_M, found - found[0], "o", ms=3, label=name)
        line = expected * np.log10(np.array(RANGES_M) / RANGES_M[0])
        axes.semilogx(RANGES_M, line, "0.6", lw=0.8)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)


MIRROR_GHOSTS_TABLE = (
    (2.0, 2.0, 10.0, 10.0000, 10.3852, 10.7703),
    (1.0, 3.0, 5.0, 5.3852, 5.8941, 6.4031),
    (5.0, 5.0, 20.0, 20.0000, 21.1803, 22.3607),
    (0.5, 1.5, 8.0, 8.0623, 8.1542, 8.2462),
)
"""Depths of sonar and target, distance; ranges of the echo and its two ghosts, m."""
REFLECTION = -0.9
MIRROR_GHOSTS_ROW_M = 0.004
SURFACE = Mirror(np.zeros(3), np.array([0.0, 0.0, -1.0]), REFLECTION)
MIRROR_GHOSTS_PHYSICS = dataclasses.replace(MEAN, speckle=True, mirrors=(SURFACE,))


def v10_mirror_ghosts() -> ValidationResult:
    """Ranges within half a cell; levels against the direct echo; the bearing kept."""
    checks = []
    for sonar_m, target_m, away_m, direct_m, once_m, twice_m in MIRROR_GHOSTS_TABLE:
        amplitude = _seen(sonar_m, target_m, away_m)
        rows = np.flatnonzero(amplitude.max(axis=1) > 0.0)
        name = f"{sonar_m:g}, {target_m:g}, {away_m:g} m"
        for row, expected in zip(rows, (direct_m, once_m, twice_m), strict=True):
            got = (row + 0.5) * MIRROR_GHOSTS_ROW_M
            checks.append(
                ValidationCheck(
                    f"{name}: echo, m", expected, float(got), MIRROR_GHOSTS_ROW_M / 2.0 + 1e-4
                )
            )
        level = 20.0 * np.log10(amplitude.max(axis=1)[rows])
        once_db = 20.0 * math.log10(2.0 * abs(REFLECTION) * direct_m / twice_m)
        twice_db = 20.0 * math.log10(REFLECTION**2 * direct_m**2 / twice_m**2)
        checks.append(
            ValidationCheck(f"{name}: ghost A, dB", once_db, float(level[1] - level[0]), 0.05)
        )
        checks.append(
            ValidationCheck(f"{name}: ghost B, dB", twice_db, float(level[2] - level[0]), 0.05)
        )
        beams = amplitude.argmax(axis=1)[rows]
        checks.append(ValidationCheck(f"{name}: beams apart", 0.0, float(np.ptp(beams)), 0.0))
    return ValidationResult(
        "V10 mirror ghosts", "image sources", tuple(checks), _draw_mirror_ghosts
    )


def _seen(sonar_m: float, target_m: float, away_m: float) -> NDArray[np.float32]:
    engine = PingEngine(
        Scene(targets=(target((away_m, 0.0, -target_m)),)),
        narrow_sonar(24.0, MIRROR_GHOSTS_ROW_M, 65),
    )
    return engine.ping(pose_at((0.0, 0.0, -sonar_m)), MIRROR_GHOSTS_PHYSICS).amplitude


def _draw_mirror_ghosts(axes: "Axes") -> None:
    level = 20.0 * np.log10(np.maximum(_seen(*MIRROR_GHOSTS_TABLE[0][:3]).max(axis=1), 1e-9))
    axes.plot((np.arange(len(level)) + 0.5) * MIRROR_GHOSTS_ROW_M, level - level.max(), lw=0.8)
    for range_m in MIRROR_GHOSTS_TABLE[0][3:]:
        axes.axvline(range_m, color="0.6", lw=0.8, ls="--")
    axes.set_xlim(9.8, 11.0)
    axes.set_ylim(-40, 5)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")


SONAR_M, WALL_M, AWAY_M = 3.0, 0.5, 10.0
END_M = AWAY_M * SONAR_M / (SONAR_M - WALL_M)
SHADOW_ROW_M = 0.01


def v11_shadow() -> ValidationResult:
    """From the wall's foot to where the ray over its top meets the floor."""
    middle = _middle()
    range_m = (np.arange(len(middle)) + 0.5) * SHADOW_ROW_M
    foot_m = float(np.hypot(AWAY_M, SONAR_M))
    dark = np.flatnonzero((middle == 0.0) & (range_m > AWAY_M))
    end_m = range_m[dark[range_m[dark] < float(np.hypot(END_M, SONAR_M)) + 0.3][-1]]
    inside = middle[(range_m > foot_m + 0.1) & (range_m < end_m - 0.1)]
    checks = (
        ValidationCheck("darkness begins, slant m", foot_m, float(range_m[dark[0]]), 0.03),
        ValidationCheck(
            "darkness ends, slant m", float(np.hypot(END_M, SONAR_M)), float(end_m), 0.08
        ),
        ValidationCheck("power in the dark", 0.0, float(inside.max()), 0.0),
    )
    return ValidationResult(
        "V11 shadow", "similar triangles: x hs / (hs - H)", checks, _draw_shadow
    )


def _middle() -> NDArray[np.float64]:
    wall = rectangle((AWAY_M, 0.0, WALL_M / 2.0), (0.0, 40.0, 0.0), (0.0, 0.0, WALL_M))
    engine = PingEngine(Scene((floor(), wall)), narrow_sonar(16.0, SHADOW_ROW_M))
    power = cell_power(engine, pose_at((0.0, 0.0, SONAR_M)), MEAN)
    middle = power.shape[1] // 2
    mean: NDArray[np.float64] = power[:, middle - 1 : middle + 1].mean(axis=1)
    return mean


def _draw_shadow(axes: "Axes") -> None:
    middle = _middle()
    level = 10.0 * np.log10(np.maximum(middle, 1e-20))
    axes.plot((np.arange(len(level)) + 0.5) * SHADOW_ROW_M, level, lw=0.8)
    for distance_m in (AWAY_M, END_M):
        axes.axvline(float(np.hypot(distance_m, SONAR_M)), color="0.6", lw=0.8, ls="--")
    axes.set_xlim(9, 14)
    axes.set_ylim(-140, -80)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")


RANGE_M = 10.0
NO_WRAP_PHYSICS = dataclasses.replace(MEAN, speckle=True, beam_width_rad=0.0175, range_spread=True)


def v17_no_wrap() -> ValidationResult:
    """A loud target and a wall at 1.2 times the range."""
    alone = _picture(Scene((floor(-2.0),)))
    far = target((1.2 * RANGE_M, 0.0, 0.0))
    wall = _wall(1.2 * RANGE_M)
    checks = (
        ValidationCheck(
            "cells a target changes", 0.0, _changed(alone, Scene((floor(-2.0),), (far,))), 0.0
        ),
        ValidationCheck(
            "cells a wall changes", 0.0, _changed(alone, Scene((floor(-2.0), wall))), 0.0
        ),
    )
    return ValidationResult(
        "V17 no wrap-around", "nothing beyond the range is heard", checks, _draw_no_wrap
    )


def _wall(range_m: float) -> Surface:
    return dataclasses.replace(
        rectangle((range_m, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 4.0)), name="wall"
    )


def _picture(scene: Scene) -> NDArray[np.float32]:
    ping = PingEngine(scene, narrow_sonar(RANGE_M, 0.02)).ping(
        pose_at((0.0, 0.0, 0.0)), NO_WRAP_PHYSICS
    )
    return ping.amplitude


def _changed(alone: NDArray[np.float32], scene: Scene) -> float:
    return float(np.count_nonzero(_picture(scene) != alone))


def _draw_no_wrap(axes: "Axes") -> None:
    picture = _picture(Scene((floor(-2.0), _wall(1.2 * RANGE_M))))
    axes.imshow(20.0 * np.log10(np.maximum(picture, 1e-9)), aspect="auto", origin="lower")
    axes.set_xlabel("beam")
    axes.set_ylabel("row")
