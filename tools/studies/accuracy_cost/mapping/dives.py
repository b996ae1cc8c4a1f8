"""The dives that mapping is studied on, and their files: capture, truth, converged map.

- `harbour`: looks ahead to 6 m, tilted, at piles, caissons and a quay over swells of sand.
- `seabed`: looks down to 10 m on sand with a caisson and pillars.
- `hard`: looks ahead to 10 m in a larger harbour, with fast turns, odometry at 10 Hz with noise and
  jitter, and another sonar whose sound draws stripes.
- `basin`: small and short, for a quick look.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim import (
    MATERIALS,
    CaptureSettings,
    Emitter,
    Motion,
    Mounting,
    OdometryErrors,
    Scenario,
    Scene,
    SonarSettings,
    Surface,
    Trajectory,
    Vehicle,
    Waypoint,
    write_capture,
)

from studies.accuracy_cost.mapping.metrics import Floor, Pile, SolidBox, Solids
from studies.accuracy_cost.study import StudyDive

__all__ = ["DIVES", "FIT", "Made", "capture_of", "made_by", "make_dive", "once", "truth_of"]

LEAD_S = 0.5
SPAN_S = 0.02
"""Added to a path so that rounding does not cost its last ping."""


@dataclass(frozen=True, slots=True)
class Made:
    """What a dive is made of.

    Attributes:
        world: the truth.
        sonar, mounting, trajectory, vehicle: as the simulator takes them.
        pings: how many.
        emitters: other sonars.
    """

    world: Solids
    sonar: SonarSettings
    mounting: Mounting
    trajectory: Trajectory
    vehicle: Vehicle
    pings: int
    emitters: Sequence[Emitter] = ()

    def scenario(self, name: str) -> Scenario:
        """For the simulator: floors are of sand, all else of overgrown concrete."""
        surfaces = []
        for i, solid in enumerate(self.world.solids):
            material = MATERIALS["sand" if isinstance(solid, Floor) else "overgrown_concrete"]
            surfaces.append(Surface(f"solid {i}", *solid.mesh(), material))
        span_s = self.trajectory.duration_s - 2 * LEAD_S - SPAN_S
        return Scenario(
            name,
            Scene(tuple(surfaces), emitters=tuple(self.emitters)),
            self.sonar,
            self.trajectory,
            self.mounting,
            self.vehicle,
            (self.pings - 1) / span_s,
        )


DIVES = (
    StudyDive("harbour", 101),
    StudyDive("seabed", 202),
    StudyDive("hard", 303),
    StudyDive("basin", 404, quick=True),
)

FIT = StudyDive("harbour to fit", 505)
"""Another harbour, whose map probabilities are calibrated by; nothing else is measured on it."""

_HARBOUR = Solids(
    (
        Floor(4.6, half_m=9.0, middle_m=(4.0, 2.5)),
        SolidBox((8.5, 2.5, -3.0), (1.0, 24.0, 6.0)),
        *(Pile((6.5, y, -3.0), 0.2, 6.0) for y in (-2.5, 0.0, 2.5, 5.0)),
        Pile((3.5, -1.5, -3.0), 0.2, 6.0),
        Pile((2.0, 6.0, -3.0), 0.2, 6.0),
        SolidBox((4.7, 1.3, -4.4), (1.2, 1.0, 1.4)),
        SolidBox((1.3, 4.2, -4.3), (1.3, 1.3, 1.6)),
    )
)
_OTHER_HARBOUR = Solids(
    (
        Floor(4.4, half_m=9.0, middle_m=(4.0, -2.5)),
        SolidBox((2.5, -8.2, -3.0), (26.0, 1.0, 6.0)),
        *(Pile((x, -6.3, -3.0), 0.2, 6.0) for x in (-1.5, 1.2, 3.9, 6.6)),
        Pile((6.2, 0.4, -3.0), 0.25, 6.0),
        Pile((4.0, 1.8, -3.0), 0.15, 6.0),
        SolidBox((4.4, -1.8, -4.2), (1.0, 1.4, 1.2)),
        SolidBox((2.2, -4.2, -4.1), (1.6, 1.0, 1.5)),
    )
)
_BAY = Solids(
    (
        Floor(6.5, half_m=16.0, middle_m=(7.0, 4.0)),
        SolidBox((13.5, 4.0, -4.0), (1.0, 40.0, 8.0)),
        *(Pile((10.5, y, -4.0), 0.3, 8.0) for y in (-4.0, 0.0, 4.0, 8.0)),
        Pile((5.5, -2.5, -4.0), 0.3, 8.0),
        Pile((3.0, 9.5, -4.0), 0.3, 8.0),
        SolidBox((7.5, 2.0, -6.2), (2.0, 1.5, 2.2)),
        SolidBox((2.0, 6.5, -6.0), (2.0, 2.0, 2.4)),
    )
)
_SEABED = Solids(
    (
        Floor(12.0, half_m=14.0),
        SolidBox((0.0, 4.0, -12.0), (2.0, 2.0, 2.4)),
        Pile((0.5, -3.0, -11.0), 0.4, 3.0),
        Pile((-1.0, 0.5, -11.5), 0.3, 2.0),
        Pile((1.0, -6.5, -10.5), 0.5, 4.0),
    )
)
_BASIN = Solids(
    (
        Floor(4.0, half_m=5.0, middle_m=(2.0, 0.0)),
        SolidBox((3.5, 1.2, -3.9), (0.8, 0.8, 1.0)),
        Pile((2.8, -0.6, -3.0), 0.15, 2.4),
    )
)


def made_by(dive: StudyDive) -> Made:
    """How a dive is made.

    Raises:
        KeyError: there is no such dive.
    """
    makers = {
        "harbour": _harbour,
        "seabed": _seabed,
        "hard": _hard,
        "basin": _basin,
        FIT.name: _harbour_to_fit,
    }
    return makers[dive.name]()


def _around(z_m: float, scale: float, motion: Motion) -> Trajectory:
    """Ahead, and round to port."""
    legs = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (4.0, 1.5, 60.0), (3.5, 4.5, 90.0), (2.0, 4.0, 30.0)]
    waypoints = [Waypoint(scale * x, scale * y, z_m, yaw) for x, y, yaw in legs]
    return Trajectory(waypoints, motion)


def _harbour() -> Made:
    path = _around(-1.9, 0.6, Motion(speed_mps=0.5, turn_rate_dps=15.0))
    sonar = SonarSettings(demanded_range_m=6.0, gain_percent=56.0)
    errors = OdometryErrors(latency_s=0.01, jitter_s=0.005)
    vehicle = Vehicle(odometry_rate_hz=20.0, errors=errors)
    return Made(_HARBOUR, sonar, Mounting(pitch_deg=30.0), path, vehicle, pings=40)


def _harbour_to_fit() -> Made:
    legs = ((0.0, 0.3, 0.0), (1.6, -0.2, -20.0), (2.6, -1.4, -75.0), (2.0, -2.6, -100.0))
    waypoints = [Waypoint(x, y, -1.8, yaw) for x, y, yaw in legs]
    path = Trajectory(waypoints, Motion(speed_mps=0.5, turn_rate_dps=18.0))
    sonar = SonarSettings(demanded_range_m=6.0, gain_percent=56.0)
    errors = OdometryErrors(latency_s=0.015, jitter_s=0.01)
    vehicle = Vehicle(odometry_rate_hz=15.0, errors=errors)
    return Made(_OTHER_HARBOUR, sonar, Mounting(pitch_deg=28.0), path, vehicle, pings=40)


def _hard() -> Made:
    path = _around(-2.7, 1.0, Motion(speed_mps=0.8, turn_rate_dps=45.0))
    sonar = SonarSettings(demanded_range_m=10.0, gain_percent=56.0)
    errors = OdometryErrors(
        position_noise_m=0.02, attitude_noise_deg=0.4, latency_s=0.02, jitter_s=0.015
    )
    vehicle = Vehicle(odometry_rate_hz=10.0, errors=errors)
    other = Emitter("another sonar", (9.0, 3.0, -3.0), 750e3, 60e3, 196.0, 0.0171, 4e-5)
    return Made(_BAY, sonar, Mounting(pitch_deg=30.0), path, vehicle, 24, (other,))


def _seabed() -> Made:
    waypoints = [Waypoint(x, 0.0, -6.0, 0.0) for x in (-2.0, 2.0)]
    path = Trajectory(waypoints, Motion(speed_mps=0.5))
    sonar = SonarSettings(demanded_range_m=10.0, gain_percent=50.0)
    vehicle = Vehicle(odometry_rate_hz=15.0, errors=OdometryErrors(latency_s=0.01, jitter_s=0.01))
    return Made(_SEABED, sonar, Mounting(pitch_deg=90.0), path, vehicle, pings=30)


def _basin() -> Made:
    waypoints = [Waypoint(x, 0.0, -2.0, yaw) for x, yaw in ((0.0, -10.0), (1.0, 20.0))]
    path = Trajectory(waypoints, Motion(speed_mps=0.4, turn_rate_dps=20.0))
    vehicle = Vehicle(odometry_rate_hz=10.0, errors=OdometryErrors(latency_s=0.01, jitter_s=0.01))
    sonar = SonarSettings(demanded_range_m=4.0, base_row_m=0.016, beams=256, gain_percent=56.0)
    return Made(_BASIN, sonar, Mounting(pitch_deg=30.0), path, vehicle, pings=16)


def _name(dive: StudyDive) -> str:
    return f"mapping-{dive.name.replace(' ', '-')}-{dive.seed}"


def capture_of(dive: StudyDive, folder: Path) -> Path:
    """File of what the dive's links brought."""
    return folder / f"{_name(dive)}.bin"


def seen_of(dive: StudyDive, folder: Path) -> Path:
    """File of what the sonar had in sight."""
    return folder / f"{_name(dive)}-seen.npy"


def truth_of(dive: StudyDive, folder: Path) -> tuple[Solids, NDArray[np.float64]]:
    """The world, and points (N, 3) of its surface that the sonar had in sight."""
    return made_by(dive).world, np.load(seen_of(dive, folder))


def make_dive(dive: StudyDive, folder: Path) -> None:
    """Simulate a dive, unless its files are there."""
    capture, seen = capture_of(dive, folder), seen_of(dive, folder)
    if capture.exists() and seen.exists():
        return
    scenario = made_by(dive).scenario(dive.name)
    part = once(capture)
    surface = write_capture(
        part, scenario, CaptureSettings(seed=dive.seed, lead_s=LEAD_S, processes=1)
    )
    beside = once(seen)
    with beside.open("wb") as file:
        np.save(file, surface.points_m.astype(np.float64))
    beside.rename(seen)
    part.rename(capture)


def once(path: Path) -> Path:
    """Where to write a file that is renamed when it is whole."""
    return path.with_name(f"{path.name}.{os.getpid()}.part")
