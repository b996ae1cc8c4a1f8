"""A dive's true path, and what its odometry makes of it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sonar_sim.trajectory import Motion, Trajectory, Waypoint

from studies.localization.world import Place

__all__ = ["Drift", "Track", "angles", "drifted", "track_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Drift:
    """How odometry errs.

    Attributes:
        scale: of the way, on top.
        yaw_rad_per_s: of the heading.
        through_water: it reckons through the water, and does not know of the current; else over
            ground, as a Doppler log does.
    """

    scale: float = 0.02
    yaw_rad_per_s: float = math.radians(1.0) / 60.0
    through_water: bool = False


CURRENT_MPS, CURRENT_TURN_S = 0.05, 600.0
"""Of the water, and in which time it goes once around the compass. Vehicles crab in it: bow and way
differ by up to 6 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The base at the times of the pings.

    Attributes:
        time_s: (N,).
        place: (N, 6) x, y, z in metres, roll, pitch, yaw in radians, map frame.
        carried_at: row that the vehicle was put to without driving there; None is none.
    """

    time_s: Floats
    place: Floats
    carried_at: int | None = None

    @property
    def way_m(self) -> Floats:
        """(N,) driven so far."""
        steps = np.hypot(*np.diff(self.place[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])


def track_of(place: Place, duration_s: float, interval_s: float, seed: int) -> Track:
    """Random legs through the place's box, the bow as far off the way as the current asks for."""
    random = np.random.default_rng((seed, 1))
    low, high = np.array(place.low_m, float), np.array(place.high_m, float)
    here = random.uniform(low, high)
    yaw_deg = random.uniform(-180.0, 180.0)
    points = [_waypoint(here, place, yaw_deg)]
    passed_s, rate_dps = 0.0, 15.0
    while passed_s < duration_s:
        there = random.uniform(low, high)
        leg = there - here
        if np.hypot(*leg) < 0.2 * np.hypot(*(high - low)):
            continue
        through = leg / np.hypot(*leg) * place.speed_mps - _current_mps(passed_s, place)
        turn = math.degrees(math.atan2(through[1], through[0])) - yaw_deg
        turn = math.remainder(turn, 360.0)
        yaw_deg += turn
        points += [
            _waypoint(here, place, yaw_deg),
            _waypoint(there, place, yaw_deg),
        ]
        passed_s += abs(turn) / rate_dps + float(np.hypot(*leg)) / place.speed_mps
        here = there
    motion = Motion(place.speed_mps, rate_dps, heave_m=0.02)
    path = Trajectory(points, motion)
    time_s = np.arange(0.0, min(duration_s, path.duration_s), interval_s)
    poses = [path.pose(float(t)) for t in time_s]
    rows = [[*p.position_m, *angles(p.rotation)] for p in poses]
    return Track(time_s, np.array(rows))


def _waypoint(here: Floats, place: Place, yaw_deg: float) -> Waypoint:
    return Waypoint(float(here[0]), float(here[1]), place.z_m, yaw_deg)


def drifted(track: Track, place: Place, drift: Drift, seed: int) -> Floats:
    """(N, 3) x, y, yaw that odometry says, from an origin of its own."""
    random = np.random.default_rng((seed, 2))
    sign = random.choice([-1.0, 1.0], 2)
    true, time_s = track.place, track.time_s
    passed_s = np.diff(time_s, prepend=time_s[0])
    steps = np.diff(true[:, :2], axis=0, prepend=true[:1, :2])
    if drift.through_water:
        steps -= _current_mps(time_s, place) * passed_s[:, None]
    steps *= 1.0 + sign[0] * drift.scale
    heading = true[:, 5].copy()
    if track.carried_at is not None:
        k = track.carried_at
        steps[k] = 0.0
        heading[k:] += heading[k - 1] - heading[k]
    # Steps turn with the heading's error at their time.
    wrong = sign[1] * drift.yaw_rad_per_s * time_s + random.uniform(-math.pi, math.pi)
    turn = heading - true[:, 5] + wrong
    c, s = np.cos(turn), np.sin(turn)
    turned = np.stack(
        [c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]], axis=1
    )
    return np.column_stack([np.cumsum(turned, axis=0), heading + wrong])


def _current_mps(time_s: float | Floats, place: Place) -> Floats:
    """(2,) or (N, 2), map frame; as much slower as the vehicle is."""
    toward = 2 * math.pi * np.asarray(time_s) / CURRENT_TURN_S
    size = CURRENT_MPS * place.speed_mps / 0.5
    return size * np.stack([np.cos(toward), np.sin(toward)], axis=-1)


def angles(rotation: Floats) -> tuple[float, float, float]:
    """Roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        -math.asin(float(np.clip(rotation[2, 0], -1.0, 1.0))),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )
