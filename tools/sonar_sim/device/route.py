"""A path that goes on where its trajectory ends: a vehicle cannot jump, and a server stays up."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.pose import Pose
from sonar_sim.trajectory import Trajectory

Ends = Literal["stop", "stay", "back"]
ENDS: tuple[Ends, ...] = ("stop", "stay", "back")
DAY_S = 86_400.0


class Route(Trajectory):
    """A trajectory, and what comes after it.

    Args:
        trajectory: the way there.
        ends: "stop" ends with it; "stay" keeps the last pose; "back" drives the same way back,
            stern first, and there again.

    Attributes:
        duration_s: of the whole; a day where it does not stop.
    """

    def __init__(self, trajectory: Trajectory, ends: Ends) -> None:
        self._there = trajectory
        self._ends = ends
        self.duration_s = trajectory.duration_s if ends == "stop" else DAY_S

    def pose(self, time_s: float) -> Pose:
        """The base in the map frame."""
        return self._there.pose(self._place(time_s)[0])

    def velocity_mps(self, time_s: float) -> NDArray[np.float64]:
        """Velocity in the body frame, (3,)."""
        place_s, sense = self._place(time_s)
        velocity: NDArray[np.float64] = sense * self._there.velocity_mps(place_s)
        return velocity

    def turn_rates_rps(self, time_s: float) -> NDArray[np.float64]:
        """Angular velocity in the body frame, rad/s, (3,)."""
        place_s, sense = self._place(time_s)
        rates: NDArray[np.float64] = sense * self._there.turn_rates_rps(place_s)
        return rates

    def _place(self, time_s: float) -> tuple[float, float]:
        """Time on the trajectory, and how fast and which way it passes: 1, 0 or -1."""
        length_s = self._there.duration_s
        if self._ends != "back" or length_s <= 0.0:
            inside = time_s < length_s
            return min(time_s, length_s), 1.0 if inside else 0.0
        turns, rest_s = divmod(time_s, length_s)
        return (length_s - rest_s, -1.0) if int(turns) % 2 else (rest_s, 1.0)
