"""A path that is known only as far as it has been driven."""

import bisect
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.pose import FramePose, require_finite, rotation_by, rotation_vector
from sonar_sim.geometry.trajectory import DAY_S, Trajectory

MAX_AHEAD_S = 0.5
"""So long a vehicle goes on after the last that was heard of it; then it stands."""
KEPT_S = 5.0
"""Of the past."""


@dataclass(frozen=True, slots=True, eq=False)
class _PathPoint:
    """Pose, and velocity and turn rates in the body frame, (3,) each, at a time."""

    time_s: float
    pose: FramePose
    velocity_mps: NDArray[np.float64]
    turn_rates_rps: NDArray[np.float64]

    def ahead(self, delay_s: float) -> FramePose:
        """The pose after a while of the same motion."""
        turn = rotation_by(self.turn_rates_rps * delay_s)
        world_mps = self.pose.rotation @ self.velocity_mps
        return FramePose(self.pose.position_m + world_mps * delay_s, self.pose.rotation @ turn)


class LivePath(Trajectory):
    """A path to which somebody adds: a simulator, an autopilot, a pilot at the keyboard.

    Between two updates a vehicle moves evenly; after the last it goes on as it moved then, for
    half a second. What is older than five seconds is forgotten. It may be used in any thread.

    Args:
        start: the pose of the base in the map until the first update.

    Raises:
        SonarSimError: the pose is not finite.

    Attributes:
        duration_s: a day.
        updates: how many there were.
    """

    live = True

    def __init__(self, start: FramePose) -> None:
        require_finite(start)
        self.duration_s = DAY_S
        self.updates = 0
        self._lock = threading.Lock()
        self._points = [_PathPoint(0.0, start, np.zeros(3), np.zeros(3))]
        self._times_s = [0.0]

    @property
    def last_s(self) -> float:
        """Time of the last update; 0 before the first."""
        return self._times_s[-1]

    def update(
        self,
        time_s: float,
        pose: FramePose,
        velocity_mps: NDArray[np.float64] | None = None,
        turn_rates_rps: NDArray[np.float64] | None = None,
    ) -> None:
        """Add what is known of the vehicle at a time.

        What is earlier than the last is ignored; at the same time it takes the last one's place.

        Args:
            time_s: on the path's clock.
            pose: map_T_base.
            velocity_mps: body frame, (3,); None is that from the last pose to this one.
            turn_rates_rps: likewise.

        Raises:
            SonarSimError: a number is not finite.
        """
        motion = (one for one in (velocity_mps, turn_rates_rps) if one is not None)
        require_finite(pose, time_s, *motion)
        with self._lock:
            before = self._points[-1]
            passed_s = time_s - before.time_s
            if self.updates and passed_s < 0.0:
                return
            known = self.updates > 0 and 0.0 < passed_s <= MAX_AHEAD_S
            if velocity_mps is None:
                moved_m = pose.rotation.T @ (pose.position_m - before.pose.position_m)
                velocity_mps = moved_m / passed_s if known else np.zeros(3)
            if turn_rates_rps is None:
                turned = rotation_vector(before.pose.rotation.T @ pose.rotation)
                turn_rates_rps = turned / passed_s if known else np.zeros(3)
            point = _PathPoint(
                time_s, pose, np.asarray(velocity_mps, float), np.asarray(turn_rates_rps, float)
            )
            if not self.updates:
                self._points, self._times_s = [], []
            elif passed_s == 0.0:
                del self._points[-1], self._times_s[-1]
            self.updates += 1
            self._points.append(point)
            self._times_s.append(time_s)
            old = bisect.bisect_left(self._times_s, time_s - KEPT_S) - 1
            if old > 0:
                del self._points[:old], self._times_s[:old]

    def jump(self, time_s: float, pose: FramePose) -> None:
        """Put the vehicle somewhere else at once, at rest.

        Raises:
            SonarSimError: the time or the pose is not finite.
        """
        require_finite(pose, time_s)
        with self._lock:
            self._points = [_PathPoint(time_s, pose, np.zeros(3), np.zeros(3))]
            self._times_s = [time_s]
            self.updates += 1

    def pose(self, time_s: float) -> FramePose:
        """The base in the map frame."""
        before, after = self._around(time_s)
        if before is after:
            ahead_s = min(max(time_s - before.time_s, 0.0), MAX_AHEAD_S)
            return before.ahead(ahead_s)
        span_s = after.time_s - before.time_s
        share = (time_s - before.time_s) / span_s
        turned = rotation_vector(before.pose.rotation.T @ after.pose.rotation)
        moved_m = after.pose.position_m - before.pose.position_m
        return FramePose(
            before.pose.position_m + share * moved_m,
            before.pose.rotation @ rotation_by(share * turned),
        )

    def velocity_mps(self, time_s: float) -> NDArray[np.float64]:
        """Velocity in the body frame, (3,)."""
        before, after = self._around(time_s)
        if before is not after:
            span_s = after.time_s - before.time_s
            world_mps = (after.pose.position_m - before.pose.position_m) / span_s
            velocity: NDArray[np.float64] = self.pose(time_s).rotation.T @ world_mps
            return velocity
        return before.velocity_mps if self._goes_on(before, time_s) else np.zeros(3)

    def turn_rates_rps(self, time_s: float) -> NDArray[np.float64]:
        """Angular velocity in the body frame, rad/s, (3,)."""
        before, after = self._around(time_s)
        if before is not after:
            turned = rotation_vector(before.pose.rotation.T @ after.pose.rotation)
            return turned / (after.time_s - before.time_s)
        return before.turn_rates_rps if self._goes_on(before, time_s) else np.zeros(3)

    @staticmethod
    def _goes_on(last: _PathPoint, time_s: float) -> bool:
        return 0.0 <= time_s - last.time_s <= MAX_AHEAD_S

    def _around(self, time_s: float) -> tuple[_PathPoint, _PathPoint]:
        """The points before and after a time; the same one beyond the first or last."""
        with self._lock:
            after = bisect.bisect_right(self._times_s, time_s)
            if after == 0:
                return self._points[0], self._points[0]
            if after == len(self._points):
                return self._points[-1], self._points[-1]
            return self._points[after - 1], self._points[after]
