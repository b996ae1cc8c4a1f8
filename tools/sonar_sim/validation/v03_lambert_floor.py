"""V3: a Lambert floor under a level sonar, with the dark ring of the vertical pattern."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    MEAN,
    cell_power,
    centre_row_mean,
    decibel,
    floor,
    narrow_sonar,
    pose_at,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT_M = 2.0
WIDTH_RAD = math.radians(20.0)
TABLE = ((10.0, -112.45, -120.65), (20.0, -127.57, -129.47), (40.0, -142.64, -143.10))
"""Range, level without and with the vertical pattern, dB."""
NEAR = (3.0, -85.12)
"""Too steep for the rays of a level sonar: seen with the sonar pitched down."""
RING_M = 5.10
TOLERANCE_DB = 0.3


def v03_lambert_floor() -> CaseResult:
    """Levels of a cell of 1 degree by 4 mm; the first echo; the ring."""
    sonar = narrow_sonar(44.0, 0.008)
    plain, patterned = _power(sonar, None), _power(sonar, WIDTH_RAD)
    checks = []
    for range_m, without_db, with_db in TABLE:
        got = _cell_db(plain, sonar, range_m)
        checks.append(Check(f"at {range_m:g} m, dB", without_db, got, TOLERANCE_DB))
        got = _cell_db(patterned, sonar, range_m)
        checks.append(Check(f"at {range_m:g} m, 20° pattern, dB", with_db, got, TOLERANCE_DB))
    checks += _near_checks()
    return CaseResult("V3 Lambert floor", "mu sin² of grazing a unit area", tuple(checks), _draw)


def _near_checks() -> list[Check]:
    """Close to the foot: the level at 3 m, the foot itself, the ring."""
    sonar = narrow_sonar(8.0)
    down = math.radians(45.0)
    pitch = np.array(
        [[math.cos(down), 0, math.sin(down)], [0, 1, 0], [-math.sin(down), 0, math.cos(down)]]
    )
    pose = dataclasses.replace(pose_at((0.0, 0.0, HEIGHT_M)), rotation=pitch)
    power = cell_power(Engine(Scene((floor(),)), sonar), pose, MEAN)
    # A cone of the pitched array holds the same ground: its sine is along the same axis.
    level = Check(f"at {NEAR[0]:g} m, dB", NEAR[1], _cell_db(power, sonar, NEAR[0]), TOLERANCE_DB)
    straight = dataclasses.replace(pose_at((0.0, 0.0, HEIGHT_M)), rotation=_straight_down())
    power = cell_power(Engine(Scene((floor(),)), sonar), straight, MEAN)
    first = float(np.flatnonzero(power.sum(axis=1))[0]) * sonar.range_resolution_m
    foot = Check("nearest floor echo, m", HEIGHT_M, first, 1.01 * sonar.range_resolution_m)
    ring = Check("dark ring, m", RING_M, _ring_m(), 0.03)
    return [level, foot, ring]


def _straight_down() -> NDArray[np.float64]:
    return np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def _ring_m() -> float:
    sonar = narrow_sonar(8.0)
    middle = _power(sonar, WIDTH_RAD).mean(axis=1)
    from_row, to_row = (round(r / sonar.range_resolution_m) for r in (4.6, 5.6))
    darkest = from_row + int(np.argmin(middle[from_row:to_row]))
    return (darkest + 0.5) * sonar.range_resolution_m


def _power(sonar: SonarSettings, width_rad: float | None) -> NDArray[np.float64]:
    physics = dataclasses.replace(MEAN, vertical_width_rad=width_rad)
    return cell_power(Engine(Scene((floor(),)), sonar), pose_at((0.0, 0.0, HEIGHT_M)), physics)


def _cell_db(power: NDArray[np.float64], sonar: SonarSettings, range_m: float) -> float:
    """Level of the reference's cell: a cell here is one column's pitch wide and one row long."""
    cell = math.radians(1.0) / sonar.sine_pitch * 0.004 / sonar.range_resolution_m
    return decibel(centre_row_mean(power, sonar, range_m) * cell)


def _draw(axes: "Axes") -> None:
    sonar = narrow_sonar(20.0, 0.01)
    for width, name in ((None, "all elevations"), (WIDTH_RAD, "20° pattern")):
        level = 10.0 * np.log10(np.maximum(_power(sonar, width).mean(axis=1), 1e-20))
        axes.plot(sonar.row_centres_m, level, lw=0.7, label=name)
    axes.axvline(RING_M, color="0.6", lw=0.8)
    axes.set_ylim(-170, -90)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)
