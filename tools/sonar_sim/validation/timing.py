"""Validation of time: ping rate and motion within a ping (V15, V16)."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import Mounting, SonarMotion
from sonar_sim.geometry.trajectory import Drift, Trajectory, Waypoint
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.scene.water import Water
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import DULL, MEAN, pose_at, rectangle, target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CAPS_HZ = (40.0, 15.0, 10.0, 5.0, 2.0)
RANGES_M = (10.0, 40.0, 120.0)
PERIODS_MS = (13.33, 53.33, 160.0)
"""2 R / c at 1500 m/s."""
SPEED_MPS = 1500.0


def v15_timing() -> ValidationResult:
    """Ping period against range, under each cap of the rate."""
    checks = [
        ValidationCheck(
            f"period at {range_m:g} m, ms", expected, _period_ms(range_m, math.inf), 0.01
        )
        for range_m, expected in zip(RANGES_M, PERIODS_MS, strict=True)
    ]
    checks += [
        ValidationCheck(
            f"rate at 1 m under a cap of {cap:g} Hz, Hz", cap, 1e3 / _period_ms(1.0, cap), 1e-9
        )
        for cap in CAPS_HZ
    ]
    return ValidationResult(
        "V15 timing", "2 R / c; caps of the fire message", tuple(checks), _draw_timing
    )


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


def _draw_timing(axes: "Axes") -> None:
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


RANGE_M = 40.0
WATER = Water(profile=((0.0, 1500.0),))
PHYSICS = dataclasses.replace(MEAN, pose_blocks=64, speckle=True)
CLOSING = SonarMotion(np.array([1.0, 0.0, 0.0]), np.zeros(3))
TURNING = SonarMotion(np.zeros(3), np.array([0.0, 0.0, math.radians(10.0)]))
APPROACH = Drift(velocity_mps=(-1.0, 0.0, 0.0))
STILL = SonarMotion(np.zeros(3), np.zeros(3))
FINE = SonarSettings(
    beams=256, half_aperture_rad=math.radians(5.0), demanded_range_m=44.0, forced_rows=44000
)


def v16_motion() -> ValidationResult:
    """Apparent range and bearing of what is 40 m away, targets and surfaces alike."""
    checks = (
        ValidationCheck("closing 1 m/s, target, mm", -26.7, _shift_mm(_target()), 1.0),
        ValidationCheck("closing 1 m/s, plate, mm", -26.7, _shift_mm(_plate()), 1.5),
        ValidationCheck("target approaching, 1 m/s, mm", -26.7, _approach_mm(_target()), 1.0),
        ValidationCheck("plate approaching, 1 m/s, mm", -26.7, _approach_mm(_plate()), 1.5),
        ValidationCheck("turning 10°/s, bearing, deg", 0.53, _turn_deg(), 0.04),
    )
    return ValidationResult("V16 motion", "v R / c; 2 omega R / c", checks, _draw_motion)


def _target() -> Scene:
    return Scene(targets=(target((RANGE_M, 0.0, 0.0)),), water=WATER)


def _plate() -> Scene:
    plate = rectangle((RANGE_M, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, 0.6), DULL)
    return Scene((plate,), water=WATER)


def _shift_mm(scene: Scene) -> float:
    return _nearest_mm(scene, CLOSING) - _nearest_mm(scene, STILL)


def _approach_mm(scene: Scene) -> float:
    """The same if the objects move, and the sonar stands still."""
    moving = Scene(
        tuple(dataclasses.replace(surface, motion=APPROACH) for surface in scene.surfaces),
        targets=tuple(dataclasses.replace(target, motion=APPROACH) for target in scene.targets),
        water=WATER,
    )
    return _nearest_mm(moving) - _nearest_mm(scene)


def _nearest_mm(scene: Scene, motion: SonarMotion | None = None) -> float:
    engine = PingEngine(scene, FINE)
    amplitude = engine.ping(pose_at((0, 0, 0)), PHYSICS, motion=motion).amplitude
    row = np.flatnonzero(amplitude.max(axis=1) > 0.0)[0]
    return float(row) * FINE.range_resolution_m * 1e3


def _turn_deg() -> float:
    """A turn to port moves what is ahead to starboard: positive bearings."""
    engine = PingEngine(_target(), FINE)
    amplitude = engine.ping(pose_at((0, 0, 0)), PHYSICS, motion=TURNING).amplitude
    beam = int(amplitude.max(axis=0).argmax())
    return math.degrees(math.asin((beam - (FINE.beams - 1) / 2.0) * FINE.sine_pitch))


def _draw_motion(axes: "Axes") -> None:
    speeds = np.linspace(-2.0, 2.0, 9)
    engine = PingEngine(_target(), FINE)
    found = []
    for speed in speeds:
        motion = SonarMotion(np.array([speed, 0.0, 0.0]), np.zeros(3))
        amplitude = engine.ping(pose_at((0, 0, 0)), PHYSICS, motion=motion).amplitude
        row = float(np.flatnonzero(amplitude.max(axis=1) > 0.0)[0])
        found.append((row * FINE.range_resolution_m - RANGE_M) * 1e3)
    axes.plot(speeds, -speeds * RANGE_M / 1500.0 * 1e3, lw=0.8, label="v R / c")
    axes.plot(speeds, found, "o", ms=3, label="simulated")
    axes.set_xlabel("closing speed, m/s")
    axes.set_ylabel("shift at 40 m, mm")
    axes.legend(fontsize=6)
