"""Trajectories of vehicles, and motions of objects: steady, swinging, or along a path."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import FramePose, rotation_of

KNOT_S = 0.05
MIN_DURATION_S, MAX_DURATION_S = 0.01, 1e5
"""Of a path; a longer one's knots would not fit into memory, nor a shorter one's smoothing."""
STEP_S = 1e-3
"""Half the step of the difference that gives the turn rates."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place to pass, map frame; the heading counts anticlockwise from east, unwrapped."""

    x_m: float
    y_m: float
    z_m: float
    yaw_deg: float
    roll_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Motion:
    """How the vehicle drives, and how the sea moves it meanwhile.

    Attributes:
        speed_mps: along straight legs.
        turn_rate_dps: of heading, where a leg turns more than it travels.
        smoothing_s: standard deviation of the Gaussian that rounds the corners.
        sway_deg: amplitude of the roll and pitch that waves cause.
        heave_m: amplitude of the waves' heave.
    """

    speed_mps: float = 0.6
    turn_rate_dps: float = 30.0
    smoothing_s: float = 0.8
    sway_deg: float = 1.0
    heave_m: float = 0.03


class Trajectory:
    """A path over time, from 0 to `duration_s`.

    Raises:
        SceneError: it takes less than a hundredth of a second, or more than a day.

    Attributes:
        live: whether it is known only as far as it has been driven.
    """

    live = False

    def __init__(self, waypoints: Sequence[Waypoint], motion: Motion | None = None) -> None:
        motion = motion or Motion()
        corners = np.array([[w.x_m, w.y_m, w.z_m, w.yaw_deg, w.roll_deg] for w in waypoints])
        legs = np.diff(corners, axis=0)
        travel_s = np.linalg.norm(legs[:, :3], axis=1) / motion.speed_mps
        turn_s = np.max(np.abs(legs[:, 3:]), axis=1) / motion.turn_rate_dps
        passed_s = np.concatenate([[0.0], np.cumsum(np.maximum(travel_s, turn_s))])
        self.duration_s = float(passed_s[-1])
        if not MIN_DURATION_S <= self.duration_s <= MAX_DURATION_S:
            raise SceneError(
                f"a path takes {MIN_DURATION_S:g} to {MAX_DURATION_S:g} s, "
                f"not {self.duration_s:g} s"
            )
        knots_s = np.linspace(0.0, self.duration_s, math.ceil(self.duration_s / KNOT_S) + 1)
        path = np.stack([np.interp(knots_s, passed_s, c) for c in corners.T], axis=1)
        rounded = gaussian_filter1d(
            path, motion.smoothing_s / (knots_s[1] - knots_s[0]), axis=0, mode="nearest"
        )
        self._state = CubicSpline(knots_s, _with_waves(knots_s, rounded, motion))

    def pose(self, time_s: float) -> FramePose:
        """The base in the map frame."""
        x, y, z, yaw, roll, pitch = self._state(time_s)
        rotation = rotation_of(math.radians(roll), math.radians(pitch), math.radians(yaw))
        return FramePose(np.array([x, y, z]), rotation)

    def velocity_mps(self, time_s: float) -> NDArray[np.float64]:
        """Velocity in the body frame, (3,)."""
        world: NDArray[np.float64] = self._state(time_s, 1)[:3]
        return self.pose(time_s).rotation.T @ world

    def turn_rates_rps(self, time_s: float) -> NDArray[np.float64]:
        """Angular velocity in the body frame, rad/s, (3,), by a central difference."""
        before = self.pose(time_s - STEP_S).rotation
        skew = before.T @ self.pose(time_s + STEP_S).rotation / (2.0 * STEP_S)
        twice = np.array(
            [skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]]
        )
        return twice / 2.0


def _with_waves(
    time_s: NDArray[np.float64], path: NDArray[np.float64], motion: Motion
) -> NDArray[np.float64]:
    """Add heave, roll and pitch of a short sea: columns x, y, z, yaw, roll, pitch."""
    x, y, z, yaw, roll = path.T
    heave = motion.heave_m * np.sin(2.0 * math.pi * time_s / 7.0)
    rolling = motion.sway_deg * np.sin(2.0 * math.pi * time_s / 4.3)
    pitching = motion.sway_deg * np.sin(2.0 * math.pi * time_s / 5.1 + 1.0)
    return np.stack([x, y, z + heave, yaw, roll + rolling, pitching], axis=1)


RouteEnd = Literal["stop", "stay", "back"]
ROUTE_ENDS: tuple[RouteEnd, ...] = ("stop", "stay", "back")
DAY_S = 86_400.0


class Route(Trajectory):
    """A trajectory, and the behaviour at its end.

    Args:
        trajectory: the trajectory.
        ends: "stop" ends the route; "stay" keeps the last pose; "back" drives back and forth,
            astern on the way back.

    Attributes:
        duration_s: total duration; a day without a stop.
    """

    def __init__(self, trajectory: Trajectory, ends: RouteEnd) -> None:
        self._there = trajectory
        self._ends = ends
        self.duration_s = trajectory.duration_s if ends == "stop" else DAY_S

    def pose(self, time_s: float) -> FramePose:
        """Return the pose of the base in the map frame."""
        return self._there.pose(self._place(time_s)[0])

    def velocity_mps(self, time_s: float) -> NDArray[np.float64]:
        """Return the velocity in the body frame, (3,)."""
        place_s, sense = self._place(time_s)
        velocity: NDArray[np.float64] = sense * self._there.velocity_mps(place_s)
        return velocity

    def turn_rates_rps(self, time_s: float) -> NDArray[np.float64]:
        """Return the angular velocity in the body frame, rad/s, (3,)."""
        place_s, sense = self._place(time_s)
        rates: NDArray[np.float64] = sense * self._there.turn_rates_rps(place_s)
        return rates

    def _place(self, time_s: float) -> tuple[float, float]:
        """Return the time on the trajectory and its rate: 1, 0 or -1."""
        length_s = self._there.duration_s
        if self._ends != "back" or length_s <= 0.0:
            inside = time_s < length_s
            return min(time_s, length_s), 1.0 if inside else 0.0
        turns, rest_s = divmod(time_s, length_s)
        return (length_s - rest_s, -1.0) if int(turns) % 2 else (rest_s, 1.0)


Triple = tuple[float, float, float]
STILL: Triple = (0.0, 0.0, 0.0)


class ObjectMotion(Protocol):
    """Where an object is at a time. It has to be sendable to another process."""

    def pose(self, time_s: float) -> FramePose:
        """The object's frame in the map, map_T_object."""


@dataclass(frozen=True, slots=True)
class Drift:
    """Steady drift and turning, with a swing on top: chains, fish, moored boats.

    Attributes:
        position_m: of the object's frame in the map at time 0.
        roll_deg, pitch_deg, yaw_deg: its attitude then.
        velocity_mps: in the map.
        yaw_rate_dps: about the vertical.
        swing_m: amplitude of a sinusoid along the map's axes.
        swing_deg: amplitude in roll, pitch and yaw.
        period_s: of the swing.
        phase_deg: of the swing at time 0.
    """

    position_m: Triple = STILL
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    velocity_mps: Triple = STILL
    yaw_rate_dps: float = 0.0
    swing_m: Triple = STILL
    swing_deg: Triple = STILL
    period_s: float = 10.0
    phase_deg: float = 0.0

    def pose(self, time_s: float) -> FramePose:
        """The object's frame in the map."""
        swing = math.sin(2.0 * math.pi * time_s / self.period_s + math.radians(self.phase_deg))
        start = np.add(self.position_m, np.multiply(self.velocity_mps, time_s))
        yaw_deg = self.yaw_deg + self.yaw_rate_dps * time_s
        steady_deg = (self.roll_deg, self.pitch_deg, yaw_deg)
        attitude_rad = np.radians(np.add(steady_deg, np.multiply(self.swing_deg, swing)))
        return FramePose(
            start + np.multiply(self.swing_m, swing),
            rotation_of(*attitude_rad),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """Along a path, repeatedly: a diver, another vehicle. The path restarts at its end.

    Attributes:
        path: of the object's frame.
    """

    path: Trajectory

    def pose(self, time_s: float) -> FramePose:
        """The object's frame in the map."""
        return self.path.pose(time_s % self.path.duration_s)
