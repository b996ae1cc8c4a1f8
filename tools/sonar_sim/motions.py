"""How objects of a scene move: steadily, swinging, or along a path."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sonar_sim.geometry.pose import Pose, rotation_of
from sonar_sim.trajectory import Trajectory

Triple = tuple[float, float, float]
STILL: Triple = (0.0, 0.0, 0.0)


class ObjectMotion(Protocol):
    """Where an object is at a time. It has to be sendable to another process."""

    def pose(self, time_s: float) -> Pose:
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

    def pose(self, time_s: float) -> Pose:
        """The object's frame in the map."""
        swing = math.sin(2.0 * math.pi * time_s / self.period_s + math.radians(self.phase_deg))
        start = np.add(self.position_m, np.multiply(self.velocity_mps, time_s))
        yaw_deg = self.yaw_deg + self.yaw_rate_dps * time_s
        steady_deg = (self.roll_deg, self.pitch_deg, yaw_deg)
        attitude_rad = np.radians(np.add(steady_deg, np.multiply(self.swing_deg, swing)))
        return Pose(
            start + np.multiply(self.swing_m, swing),
            rotation_of(*attitude_rad),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """Along a path, over and over: a diver, another vehicle. It begins anew where the path ends.

    Attributes:
        path: of the object's frame.
    """

    path: Trajectory

    def pose(self, time_s: float) -> Pose:
        """The object's frame in the map."""
        return self.path.pose(time_s % self.path.duration_s)
