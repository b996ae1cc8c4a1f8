"""Validation in a tank: simulated against published pictures of real pings (V20).

A round tank with one target in it, as in published comparisons of simulated and real pings.

Choi and others (2021) showed an Oculus M1200d's pings of an empty tank, a vertical rod, a
horizontal rod and a plate of 0.5 x 0.6 m. Their recordings are not public and their distances not
stated: these are ours.
"""

import math
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
import trimesh
from numpy.typing import NDArray

from oculus_driver.render import Style
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.products.images import fan_picture
from sonar_sim.products.sounding import ProductRenderer
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.depth_camera import pinhole_of
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Sea, Surface
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.validation.case import ValidationCheck, ValidationResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TANK_RADIUS_M: Final = 2.2
TANK_DEPTH_M: Final = 2.0
SONAR_X_M: Final = -1.0
TARGET_X_M: Final = 0.8
TARGET_RANGE_M: Final = TARGET_X_M - SONAR_X_M
WALL_RANGE_M: Final = TANK_RADIUS_M - SONAR_X_M
ROD_RADIUS_M: Final = 0.02
ROD_LENGTH_M: Final = 0.6
PLATE_M: Final = (0.02, 0.5, 0.6)
LYING: Final = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
TARGETS: Final = ("background", "vertical rod", "horizontal rod", "plate")


def tank_scene(target: str) -> Scene:
    """Build the tank, open above, with one of `TARGETS` at half its depth."""
    upright = [[TANK_RADIUS_M, -TANK_DEPTH_M / 2.0], [TANK_RADIUS_M, TANK_DEPTH_M / 2.0]]
    wall = trimesh.creation.revolve(upright, sections=120)
    bottom = trimesh.creation.cylinder(TANK_RADIUS_M, 0.02, sections=120)
    surfaces = [
        _surface("wall", wall, (0.0, 0.0, -TANK_DEPTH_M / 2.0), "concrete"),
        _surface("bottom", bottom, (0.0, 0.0, -TANK_DEPTH_M - 0.01), "concrete"),
    ]
    middle = (TARGET_X_M, 0.0, -TANK_DEPTH_M / 2.0)
    if target == "plate":
        surfaces.append(_surface(target, trimesh.creation.box(PLATE_M), middle, "aluminium"))
    elif target.endswith("rod"):
        rod = trimesh.creation.cylinder(ROD_RADIUS_M, ROD_LENGTH_M, sections=48)
        if target == "horizontal rod":
            rod.apply_transform(LYING)
        surfaces.append(_surface(target, rod, middle, "aluminium"))
    return Scene(tuple(surfaces), sea=Sea(rms_height_m=0.0))


def tank_pose() -> FramePose:
    """Level, at half the tank's depth, looking at the target."""
    return FramePose(np.array([SONAR_X_M, 0.0, -TANK_DEPTH_M / 2.0]), np.eye(3))


def _surface(
    name: str, mesh: trimesh.Trimesh, centre_m: tuple[float, float, float], material: str
) -> Surface:
    return Surface(
        name,
        np.asarray(mesh.vertices, dtype=np.float64) + np.array(centre_m),
        np.asarray(mesh.faces, dtype=np.int64),
        MATERIALS[material],
    )


RANGE_M = 3.5
NEAR_TARGET_M = 0.15
"""Rows about a target's front that are taken for its echo."""
LOUD = 10.0 ** (-10.0 / 20.0)
"""A target reaches as far as its echo is within 10 dB of its loudest."""


def v20_tank() -> ValidationResult:
    """Range, width and contrast of each target."""
    checks = [check for mode in (1, 2) for check in _checks(band(mode))]
    source = "geometry; Choi et al. 2021 show the like"
    return ValidationResult("V20 round tank", source, tuple(checks), partial(_draw, mode=2))


def band(mode: int) -> SonarSettings:
    """An M1200d in its 1.2 MHz (1) or 2.1 MHz (2) band, set for the tank."""
    return sonar_preset("M1200d", mode, demanded_range_m=RANGE_M, gain_percent=70.0)


def picture(target: str, mode: int, height_px: int = 420) -> NDArray[np.uint8]:
    """Fan picture of one target, blue first."""
    sonar = band(mode)
    sounder = ProductRenderer(tank_scene(target), sonar, pinhole_of(sonar, 64))
    return fan_picture(sounder.at(tank_pose()), Style(height_px=height_px, labels=False))


def _checks(sonar: SonarSettings) -> list[ValidationCheck]:
    name = f"{sonar.frequency_hz / 1e6:.1f} MHz"
    quiet = _echo("background", sonar)
    wall_m = _loudest_m(quiet[:, sonar.beams // 2], sonar, WALL_RANGE_M)
    row_m = sonar.range_resolution_m
    checks = [ValidationCheck(f"{name}: wall, m", WALL_RANGE_M, wall_m, 2.0 * row_m)]
    halves_m = {"vertical rod": ROD_RADIUS_M, "horizontal rod": 0.3, "plate": 0.25}
    fronts_m = {"plate": PLATE_M[0] / 2.0}
    for target, half_m in halves_m.items():
        echo = np.sqrt(np.maximum(np.square(_echo(target, sonar)) - np.square(quiet), 0.0))
        front_m = TARGET_RANGE_M - fronts_m.get(target, ROD_RADIUS_M)
        near = np.abs(sonar.row_centres_m - front_m) < NEAR_TARGET_M
        middle = echo[:, sonar.beams // 2]
        checks += [
            ValidationCheck(
                f"{name}: {target}, m", front_m, _loudest_m(middle, sonar, front_m), 2.0 * row_m
            ),
            ValidationCheck(
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
    return PingEngine(tank_scene(target), sonar).ping(tank_pose(), physics).amplitude


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
    rows = [[picture(target, mode, 240) for target in pair] for pair in _pairs(TARGETS)]
    axes.imshow(np.vstack([np.hstack(row) for row in rows])[..., ::-1])
    axes.set_xlabel("background, vertical rod; horizontal rod, plate")
    axes.set_xticks([])
    axes.set_yticks([])


def _pairs(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [names[:2], names[2:]]
