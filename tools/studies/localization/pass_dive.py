"""Two passes over one place as recordings: pings with all effects, and odometry that drifts."""

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim import Pose, Scenario
from sonar_sim.capture import CaptureSettings, ping_times_s, write_capture
from sonar_sim.poses import Mounting, rotation_of
from sonar_sim.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.vehicle import OdometrySample
from tqdm import tqdm

from studies.localization.track import Drift, Track, angles, drifted
from studies.localization.world import Place

__all__ = ["AHEAD", "FIRST", "SECOND", "Pass", "navigation", "ping_poses", "record"]

Floats = NDArray[np.float64]
Corner = tuple[float, float, float]
"""x and y in metres, heading in degrees."""

RECORD_HZ = 25.0
LATENCY_S = 0.002
NOISE_M, NOISE_DEG = 0.005, 0.1
"""White errors of a record, as the simulator's vehicles have them."""
TURN_RATE_DPS = 15.0
AHEAD = Mounting(position_m=(0.3, 0.0, 0.0), pitch_deg=0.0)
"""At the bow, looking along it."""
FRESH = Drift(0.002, math.radians(0.1) / 60.0)
"""A tenth of what odometry drifts by: a first pass under a fix."""


@dataclass(frozen=True, slots=True)
class Pass:
    """A way past a place.

    Attributes:
        corners: with the heading in each; between them the vehicle goes straight.
        away: corners before, with the sonar silent: the odometry begins there at the truth.
        drift: of the odometry, from there on.
        ping_rate_hz: asked for.
        seed: of noise and odometry.
    """

    corners: tuple[Corner, ...]
    away: tuple[Corner, ...] = ()
    drift: Drift = field(default_factory=Drift)
    ping_rate_hz: float = 4.0
    seed: int = 1

    def over(self, scenario: Scenario, place: Place) -> Scenario:
        """The scenario with this path."""
        path = _trajectory((*self.away, *self.corners), place)
        rate_hz = self.ping_rate_hz
        return dataclasses.replace(scenario, trajectory=path, mounting=AHEAD, ping_rate_hz=rate_hz)

    def quiet_s(self, place: Place) -> float:
        """Before the sonar sounds."""
        if not self.away:
            return 0.0
        return _trajectory((*self.away, self.corners[0]), place).duration_s


FIRST = Pass(
    ((-15, -2, 50), (15, -2, 50), (15, -2, 130), (15, -6, 130), (-15, -6, 130)), drift=FRESH
)
SECOND = Pass(
    ((15, -4.5, 115), (-15, -3, 115), (-15, -3, 70), (-15, -7, 70), (15, -5, 70)),
    away=((-15, -6, 130), (-15, -10, 0), (15, -9, 0), (15, -5, 180), (-15, -9, 180), (15, -9, 0)),
    seed=2,
)


def record(path: Path, what: Pass, scenario: Scenario, place: Place, processes: int = 1) -> Floats:
    """Simulate a pass into a recording.

    Args:
        path: of the recording.
        what: the pass.
        scenario: scene and sonar.
        place: speed and height.
        processes: that simulate; changes nothing in the file.

    Returns:
        (N, 3) points of the surfaces that the sonar had in sight, map frame.
    """
    driven = what.over(scenario, place)
    settings = CaptureSettings(what.seed, quiet_s=what.quiet_s(place), processes=processes)
    said = navigation(driven.trajectory, place, what)
    with tqdm(desc=path.stem, unit="ping", disable=None) as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        return write_capture(path, driven, settings, progress, said).points_m


def ping_poses(what: Pass, scenario: Scenario, place: Place) -> tuple[Floats, list[Pose]]:
    """When the pings leave, in seconds on the path, and where the vehicle truly is then."""
    driven = what.over(scenario, place)
    times_s = ping_times_s(driven, CaptureSettings(quiet_s=what.quiet_s(place)))
    return np.array(times_s), [driven.trajectory.pose(t) for t in times_s]


def navigation(path: Trajectory, place: Place, what: Pass) -> list[OdometrySample]:
    """What the odometry says on a path: right at its beginning, from there on with its drift.

    Depth, roll and pitch are a sensor's and do not drift.
    """
    time_s = np.arange(0.0, path.duration_s, 1.0 / RECORD_HZ)
    poses = [path.pose(float(t)) for t in time_s]
    true = np.array([[*pose.position_m, *angles(pose.rotation)] for pose in poses])
    said = _begun_at(true[0], drifted(Track(time_s, true), place, what.drift, what.seed))
    place_m = np.column_stack([said[:, :2], true[:, 2]])
    speed_mps = np.gradient(place_m, time_s, axis=0)
    noise = np.random.default_rng((what.seed, 4)).normal(size=(2, *place_m.shape))
    samples = []
    for k, t in enumerate(time_s.tolist()):
        rotation = rotation_of(true[k, 3], true[k, 4], said[k, 2])
        tilt = rotation_of(*np.radians(NOISE_DEG * noise[1, k]))
        samples.append(
            OdometrySample(
                t,
                t + LATENCY_S,
                Pose(place_m[k] + NOISE_M * noise[0, k], rotation @ tilt),
                rotation.T @ speed_mps[k],
                path.turn_rates_rps(t),
            )
        )
    return samples


def _trajectory(corners: tuple[Corner, ...], place: Place) -> Trajectory:
    points = [Waypoint(x, y, place.z_m, yaw) for x, y, yaw in corners]
    return Trajectory(points, Motion(place.speed_mps, TURN_RATE_DPS, heave_m=0.02))


def _begun_at(first: Floats, said: Floats) -> Floats:
    """(N, 3) the odometry's places and headings in the map, its first one the true one."""
    turn = first[5] - said[0, 2]
    c, s = math.cos(turn), math.sin(turn)
    placed = (said[:, :2] - said[0, :2]) @ np.array([[c, s], [-s, c]]) + first[:2]
    return np.column_stack([placed, said[:, 2] + turn])
