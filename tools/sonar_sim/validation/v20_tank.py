"""V20: the published set of pings in a round tank, in both bands of an M1200d."""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oculus_driver.render import Style
from sonar_sim.engine import Engine
from sonar_sim.products.fan import fan_picture
from sonar_sim.products.sounding import Sounder
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.depth_camera import pinhole_of
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.validation import tank
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RANGE_M = 3.5
NEAR_TARGET_M = 0.15
"""Rows about a target's front that are taken for its echo."""
LOUD = 10.0 ** (-10.0 / 20.0)
"""A target reaches as far as its echo is within 10 dB of its loudest."""


def v20_tank() -> CaseResult:
    """Range, width and contrast of each target."""
    checks = [check for mode in (1, 2) for check in _checks(band(mode))]
    source = "geometry; Choi et al. 2021 show the like"
    return CaseResult("V20 round tank", source, tuple(checks), partial(_draw, mode=2))


def band(mode: int) -> SonarSettings:
    """An M1200d in its 1.2 MHz (1) or 2.1 MHz (2) band, set for the tank."""
    return sonar_preset("M1200d", mode, demanded_range_m=RANGE_M, gain_percent=70.0)


def picture(target: str, mode: int, height_px: int = 420) -> NDArray[np.uint8]:
    """Fan picture of one target, blue first."""
    sonar = band(mode)
    sounder = Sounder(tank.tank_scene(target), sonar, pinhole_of(sonar, 64))
    return fan_picture(sounder.at(tank.tank_pose()), Style(height_px=height_px, labels=False))


def _checks(sonar: SonarSettings) -> list[Check]:
    name = f"{sonar.frequency_hz / 1e6:.1f} MHz"
    quiet = _echo("background", sonar)
    wall_m = _loudest_m(quiet[:, sonar.beams // 2], sonar, tank.WALL_RANGE_M)
    row_m = sonar.range_resolution_m
    checks = [Check(f"{name}: wall, m", tank.WALL_RANGE_M, wall_m, 2.0 * row_m)]
    halves_m = {"vertical rod": tank.ROD_RADIUS_M, "horizontal rod": 0.3, "plate": 0.25}
    fronts_m = {"plate": tank.PLATE_M[0] / 2.0}
    for target, half_m in halves_m.items():
        echo = np.sqrt(np.maximum(np.square(_echo(target, sonar)) - np.square(quiet), 0.0))
        front_m = tank.TARGET_RANGE_M - fronts_m.get(target, tank.ROD_RADIUS_M)
        near = np.abs(sonar.row_centres_m - front_m) < NEAR_TARGET_M
        middle = echo[:, sonar.beams // 2]
        checks += [
            Check(f"{name}: {target}, m", front_m, _loudest_m(middle, sonar, front_m), 2.0 * row_m),
            Check(
                f"{name}: half width of the {target}, °",
                math.degrees(math.atan(half_m / front_m)),
                _half_width_deg(echo[near].max(axis=0), sonar),
                1.5 * math.degrees(sonar.beam_width_rad),
            ),
        ]
    return checks


def _echo(target: str, sonar: SonarSettings) -> NDArray[np.float32]:
    """Expected amplitude by geometry and beams alone, (rows, beams)."""
    physics = Physics(
        spreading=True,
        lambert=True,
        shadows=True,
        vertical_width_rad=sonar.vertical_width_rad,
        beam_width_rad=sonar.beam_width_rad,
        sine_bearings=True,
    )
    return Engine(tank.tank_scene(target), sonar).ping(tank.tank_pose(), physics).amplitude


def _loudest_m(column: NDArray[np.float32], sonar: SonarSettings, about_m: float) -> float:
    """Range of the loudest row near a range."""
    ranges_m = sonar.row_centres_m
    near = np.where(np.abs(ranges_m - about_m) < NEAR_TARGET_M, column, 0.0)
    return float(ranges_m[int(np.argmax(near))])


def _half_width_deg(level: NDArray[np.float32], sonar: SonarSettings) -> float:
    """Half the span of bearings whose level is within 10 dB of the greatest."""
    sines = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    bearings_deg = np.degrees(np.arcsin(sines))[level > LOUD * level.max()]
    return float(np.ptp(bearings_deg)) / 2.0


def _draw(axes: "Axes", mode: int) -> None:
    rows = [[picture(target, mode, 240) for target in pair] for pair in _pairs(tank.TARGETS)]
    axes.imshow(np.vstack([np.hstack(row) for row in rows])[..., ::-1])
    axes.set_xlabel("background, vertical rod; horizontal rod, plate")
    axes.set_xticks([])
    axes.set_yticks([])


def _pairs(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [names[:2], names[2:]]
