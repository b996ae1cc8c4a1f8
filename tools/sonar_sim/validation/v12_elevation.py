"""V12: what elevation does that a line array cannot tell."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.scene import PointTarget, Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import MEAN, decibel, narrow_sonar, pose_at, target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RANGE_M = 5.0
TILT_RAD = math.radians(5.0)
PAIRS = 24
"""Phases between the two, evenly around the circle."""
PHYSICS = dataclasses.replace(MEAN, speckle=True, vertical_width_rad=math.radians(20.0))


def v12_elevation() -> CaseResult:
    """Two targets in one cell; the cone of a target aside and above."""
    one = _peak((_at(TILT_RAD, RANGE_M),), PHYSICS)
    level = _peak((_at(TILT_RAD, RANGE_M),), dataclasses.replace(PHYSICS, vertical_width_rad=None))
    wavelength_m = Scene().water.speed_of_sound_mps / SonarSettings().frequency_hz
    steps = np.arange(PAIRS) / PAIRS * wavelength_m / 2.0
    both = [
        _peak((_at(TILT_RAD, RANGE_M), _at(-TILT_RAD, RANGE_M + step)), PHYSICS) for step in steps
    ]
    checks = (
        Check("one target, dB", -1.44, decibel(one / level), 0.02),
        Check("two over one, dB", 3.01, decibel(float(np.mean(both)) / one), 0.02),
        Check("bearing of the cone, deg", 39.27, _cone_deg(), 0.15),
    )
    return CaseResult("V12 elevation", "sin(cone) = sin(az) cos(el)", checks, _draw)


def _at(elevation_rad: float, range_m: float) -> PointTarget:
    # Inside a row, so that both share it.
    reach = range_m + 0.001
    return target(
        (reach * math.cos(elevation_rad), 0.0, reach * math.sin(elevation_rad)),
        f"at {elevation_rad:g}",
    )


def _peak(targets: tuple[PointTarget, ...], physics: Physics) -> float:
    return float(np.square(_picture(targets, narrow_sonar(6.0, beams=33), physics)).max())


def _picture(
    targets: tuple[PointTarget, ...], sonar: SonarSettings, physics: Physics
) -> NDArray[np.float64]:
    engine = Engine(Scene(targets=targets), sonar, elevations=1)
    shown = engine.ping(pose_at((0.0, 0.0, 0.0)), physics).amplitude
    return shown.astype(np.float64)


def _cone_deg() -> float:
    sonar = SonarSettings(beams=512)
    azimuth, elevation = math.radians(40.0), math.radians(10.0)
    place = (
        RANGE_M * math.cos(elevation) * math.cos(azimuth),
        -RANGE_M * math.cos(elevation) * math.sin(azimuth),
        RANGE_M * math.sin(elevation),
    )
    picture = _picture((target(place),), sonar, PHYSICS)
    beam = int(picture.max(axis=0).argmax())
    return math.degrees(math.asin((beam - (sonar.beams - 1) / 2.0) * sonar.sine_pitch))


def _draw(axes: "Axes") -> None:
    elevations = np.radians(np.arange(0.0, 31.0, 1.0))
    free = dataclasses.replace(PHYSICS, vertical_width_rad=None)
    found = [
        decibel(_peak((_at(e, RANGE_M),), PHYSICS) / _peak((_at(e, RANGE_M),), free))
        for e in elevations
    ]
    axes.plot(np.degrees(elevations), found, "o", ms=3)
    axes.set_ylim(-60, 3)
    axes.set_xlabel("elevation, degrees")
    axes.set_ylabel("two-way pattern, dB")
