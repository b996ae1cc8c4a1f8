"""Validation of scattering: floor, spheres, plate, elevation (V3, V4, V5, V12)."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import PingEngine
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD, ELEVATIONS
from sonar_sim.scene.scene import PointTarget, Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import (
    CHALK,
    DULL,
    MEAN,
    MIRROR,
    cell_power,
    centre_row_mean,
    decibel,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    sphere,
    target,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sonar_sim.scene.material import Material

HEIGHT_M = 2.0
WIDTH_RAD = math.radians(20.0)
LAMBERT_FLOOR_TABLE = ((10.0, -112.45, -120.65), (20.0, -127.57, -129.47), (40.0, -142.64, -143.10))
"""Range, level without and with the vertical pattern, dB."""
NEAR = (3.0, -85.12)
"""More than 40° under a level sonar: seen by a fan of all elevations."""
RING_M = 5.10
TOLERANCE_DB = 0.3


def v03_lambert_floor() -> ValidationResult:
    """Levels of a cell of 1 degree by 4 mm; the first echo; the ring."""
    sonar = narrow_sonar(44.0, 0.008)
    plain, patterned = _power(sonar, None), _power(sonar, WIDTH_RAD)
    checks = []
    for range_m, without_db, with_db in LAMBERT_FLOOR_TABLE:
        got = _cell_db(plain, sonar, range_m)
        checks.append(ValidationCheck(f"at {range_m:g} m, dB", without_db, got, TOLERANCE_DB))
        got = _cell_db(patterned, sonar, range_m)
        checks.append(
            ValidationCheck(f"at {range_m:g} m, 20° pattern, dB", with_db, got, TOLERANCE_DB)
        )
    checks += _near_checks()
    return ValidationResult(
        "V3 Lambert floor", "mu sin² of grazing a unit area", tuple(checks), _draw_lambert_floor
    )


def _near_checks() -> list[ValidationCheck]:
    """Close to the foot: the level at 3 m, the foot itself, the ring."""
    sonar = narrow_sonar(8.0)
    all_around = dataclasses.replace(MEAN, elevations_rad=ALL_ELEVATIONS_RAD)
    level_pose = pose_at((0.0, 0.0, HEIGHT_M))
    power = cell_power(PingEngine(Scene((floor(),)), sonar), level_pose, all_around)
    level = ValidationCheck(
        f"at {NEAR[0]:g} m, dB", NEAR[1], _cell_db(power, sonar, NEAR[0]), TOLERANCE_DB
    )
    row_m, foot_row = sonar.range_resolution_m, round(HEIGHT_M / sonar.range_resolution_m)
    per_cell = power[foot_row, 28:36].mean() * math.radians(1.0) / sonar.sine_pitch
    # A strip of width h ds along the track, as far as sqrt(2 h dR) ahead, at normal incidence.
    strip_m2 = HEIGHT_M * math.radians(1.0) * math.sqrt(2.0 * HEIGHT_M * row_m)
    below = ValidationCheck(
        "straight below, dB",
        decibel(DULL.mu * strip_m2 / HEIGHT_M**4),
        decibel(per_cell),
        TOLERANCE_DB,
    )
    first = float(np.flatnonzero(power.sum(axis=1) > 1e-3 * power.sum(axis=1).max())[0]) * row_m
    foot = ValidationCheck("nearest floor echo, m", HEIGHT_M, first, 1.01 * row_m)
    ring = ValidationCheck("dark ring, m", RING_M, _ring_m(), 0.03)
    return [level, below, foot, ring]


def _ring_m() -> float:
    sonar = narrow_sonar(8.0)
    middle = _power(sonar, WIDTH_RAD).mean(axis=1)
    from_row, to_row = (round(r / sonar.range_resolution_m) for r in (4.6, 5.6))
    darkest = from_row + int(np.argmin(middle[from_row:to_row]))
    return (darkest + 0.5) * sonar.range_resolution_m


def _power(sonar: SonarSettings, width_rad: float | None) -> NDArray[np.float64]:
    physics = dataclasses.replace(MEAN, vertical_width_rad=width_rad)
    return cell_power(PingEngine(Scene((floor(),)), sonar), pose_at((0.0, 0.0, HEIGHT_M)), physics)


def _cell_db(power: NDArray[np.float64], sonar: SonarSettings, range_m: float) -> float:
    """Level of the reference's cell: a cell here is one column's pitch wide and one row long."""
    cell = math.radians(1.0) / sonar.sine_pitch * 0.004 / sonar.range_resolution_m
    return decibel(centre_row_mean(power, sonar, range_m) * cell)


def _draw_lambert_floor(axes: "Axes") -> None:
    sonar = narrow_sonar(20.0, 0.01)
    for width, name in ((None, "all elevations"), (WIDTH_RAD, "20° pattern")):
        level = 10.0 * np.log10(np.maximum(_power(sonar, width).mean(axis=1), 1e-20))
        axes.plot(sonar.row_centres_m, level, lw=0.7, label=name)
    axes.axvline(RING_M, color="0.6", lw=0.8)
    axes.set_ylim(-170, -90)
    axes.set_xlabel("range, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)


SPHERES_TABLE = (
    (0.05, -32.04, -32.81),
    (0.10, -26.02, -26.79),
    (0.25, -18.06, -18.83),
    (0.50, -12.04, -12.81),
)
"""Radius, strength of a rigid one and of a Lambert one with mu 0.1."""
AWAY = 40.0
"""Range over radius: far enough for the table, whose waves are plane."""
FINE = 1120
"""Rays a column that meet a sphere so far off within a facet of its limb."""


def v04_spheres() -> ValidationResult:
    """Sums over all cells, with each one's own spreading taken off."""
    checks = []
    for radius_m, rigid_db, dull_db in SPHERES_TABLE:
        sonar, power = _seen_spheres(radius_m, MIRROR)
        range_m = AWAY * radius_m
        # From a distance d the mirrored wave spreads as if from behind: a²/4 / (d² (d + a)²).
        got = decibel(power.sum() * (range_m - radius_m) ** 2 * range_m**2)
        checks.append(ValidationCheck(f"rigid, {radius_m:g} m, dB", rigid_db, got, TOLERANCE_DB))
        sonar, power = _seen_spheres(radius_m, CHALK)
        got = decibel(float((power.sum(axis=1) * sonar.row_centres_m**4).sum()))
        checks.append(ValidationCheck(f"Lambert, {radius_m:g} m, dB", dull_db, got, TOLERANCE_DB))
    checks += _extents(*_seen_spheres(SPHERES_TABLE[-1][0], CHALK, FINE))
    return ValidationResult(
        "V4 spheres", "20 log(a/2); 10 log(2 pi mu a²/3)", tuple(checks), _draw_spheres
    )


def _extents(sonar: SonarSettings, power: NDArray[np.float64]) -> list[ValidationCheck]:
    """From the nearest point to the limb, and from side to side."""
    radius_m = SPHERES_TABLE[-1][0]
    range_m = AWAY * radius_m
    rows = np.flatnonzero(power.sum(axis=1) > 0.0) * sonar.range_resolution_m
    beams = np.flatnonzero(power.sum(axis=0) > 0.0)
    # A face's plane is followed a face's length beyond what the ray met.
    facet_m = radius_m * math.radians(63.4) / 32.0
    limb_m = math.sqrt(range_m**2 - radius_m**2)
    wide = float(beams[-1] - beams[0] + 1) * sonar.sine_pitch
    return [
        ValidationCheck("nearest echo, m", range_m - radius_m, float(rows[0]), facet_m),
        ValidationCheck("limb, m", limb_m, float(rows[-1]), 2.5 * facet_m),
        ValidationCheck("width in sine", 2.0 * radius_m / range_m, wide, 2.0 * sonar.sine_pitch),
    ]


def _seen_spheres(
    radius_m: float, material: "Material", elevations: int = ELEVATIONS
) -> tuple[SonarSettings, NDArray[np.float64]]:
    range_m = AWAY * radius_m
    sonar = narrow_sonar(1.1 * range_m)
    scene = Scene((sphere((range_m, 0.0, 0.0), radius_m, material),))
    engine = PingEngine(scene, sonar, elevations=elevations)
    return sonar, cell_power(engine, pose_at((0.0, 0.0, 0.0)), MEAN)


def _draw_spheres(axes: "Axes") -> None:
    for radius_m, _, _ in SPHERES_TABLE:
        sonar, power = _seen_spheres(radius_m, CHALK)
        level = 10.0 * np.log10(np.maximum(power.sum(axis=1), 1e-12))
        axes.plot(sonar.row_centres_m - AWAY * radius_m, level, lw=0.8, label=f"{radius_m:g} m")
    axes.set_xlim(-0.6, 0.1)
    axes.set_ylim(-120, -70)
    axes.set_xlabel("range beyond the centre, m")
    axes.set_ylabel("level, dB")
    axes.legend(fontsize=6)


RANGES_M = (0.5, 1.0, 2.0, 5.0, 10.0)
CUTS = (1, 2, 4, 8)
"""2, 8, 32 and 128 triangles."""
SPECKLED = dataclasses.replace(MEAN, speckle=True)


def v05_plate() -> ValidationResult:
    """0.5 m by 0.6 m: the mirror law near by, and invariance of the dull plate."""
    checks = [
        ValidationCheck(f"mirror at {r:g} m, dB", 20.0 * math.log10(r / 2.0), _mirror_db(r), 0.3)
        for r in RANGES_M
    ]
    whole = decibel(_dull(1).sum())
    checks += [
        ValidationCheck(f"{2 * cuts**2} triangles, dB", whole, decibel(_dull(cuts).sum()), 0.05)
        for cuts in CUTS[1:]
    ]
    checks.append(
        ValidationCheck("twice the rays, dB", whole, decibel(_dull(1, rays=2).sum()), 0.1)
    )
    area_db = decibel(DULL.mu * 0.3 / 5.0**4)
    checks.append(ValidationCheck("mu A / R⁴, dB", area_db, whole, 0.1))
    same = np.abs(_speckled(1) - _speckled(8)).max() / _speckled(1).max()
    checks.append(
        ValidationCheck("speckle of 2 and 128 triangles, of its peak", 0.0, float(same), 1e-3)
    )
    return ValidationResult(
        "V5 plate", "mirror law R²/4; sums of mu cos² dA", tuple(checks), _draw_plate
    )


def _mirror_db(range_m: float) -> float:
    return decibel(_seen_plate(range_m, MIRROR, 1, 1).sum() * range_m**4)


def _dull(cuts: int, rays: int = 1) -> NDArray[np.float64]:
    return _seen_plate(5.0, DULL, cuts, rays)


def _seen_plate(range_m: float, material: "Material", cuts: int, rays: int) -> NDArray[np.float64]:
    plate = rectangle((range_m, 0, 0), (0, 0.5, 0), (0, 0, 0.6), material, cuts)
    engine = PingEngine(Scene((plate,)), narrow_sonar(1.1 * range_m), elevations=ELEVATIONS * rays)
    return cell_power(engine, pose_at((0.0, 0.0, 0.0)), MEAN)


def _speckled(cuts: int) -> NDArray[np.float32]:
    """A plate askew, so that its echo has many rows."""
    plate = rectangle((5.0, 0, 0), (0.3, 0.4, 0), (0.3, 0, 0.5), DULL, cuts)
    engine = PingEngine(Scene((plate,)), narrow_sonar(6.0))
    return engine.ping(pose_at((0.0, 0.0, 0.0)), SPECKLED).amplitude


def _draw_plate(axes: "Axes") -> None:
    ranges = np.linspace(2.0, 12.0, 11)
    axes.plot(ranges, 20.0 * np.log10(ranges / 2.0), lw=0.8, label="mirror law")
    axes.plot(ranges, [_mirror_db(r) for r in ranges], "o", ms=3, label="simulated")
    axes.set_xlabel("range, m")
    axes.set_ylabel("target strength, dB")
    axes.legend(fontsize=6)


RANGE_M = 5.0
TILT_RAD = math.radians(5.0)
PAIRS = 24
"""Phases between the two, evenly around the circle."""
PHYSICS = dataclasses.replace(MEAN, speckle=True, vertical_width_rad=math.radians(20.0))


def v12_elevation() -> ValidationResult:
    """Two targets in one cell; the cone of a target aside and above."""
    one = _peak((_at(TILT_RAD, RANGE_M),), PHYSICS)
    level = _peak((_at(TILT_RAD, RANGE_M),), dataclasses.replace(PHYSICS, vertical_width_rad=None))
    wavelength_m = Scene().water.speed_of_sound_mps / SonarSettings().frequency_hz
    steps = np.arange(PAIRS) / PAIRS * wavelength_m / 2.0
    both = [
        _peak((_at(TILT_RAD, RANGE_M), _at(-TILT_RAD, RANGE_M + step)), PHYSICS) for step in steps
    ]
    checks = (
        ValidationCheck("one target, dB", -1.44, decibel(one / level), 0.02),
        ValidationCheck("two over one, dB", 3.01, decibel(float(np.mean(both)) / one), 0.02),
        ValidationCheck("bearing of the cone, deg", 39.27, _cone_deg(), 0.15),
    )
    return ValidationResult("V12 elevation", "sin(cone) = sin(az) cos(el)", checks, _draw_elevation)


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
    engine = PingEngine(Scene(targets=targets), sonar, elevations=1)
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


def _draw_elevation(axes: "Axes") -> None:
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
