"""A vehicle that is driven: commanded velocities, followed with a lag."""

import math
from dataclasses import dataclass, fields

import numpy as np

from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import FramePose, rotation_of

LAG_S = 0.6
"""Time in which a small ROV takes up two thirds of a change of its velocity."""
MAX_STEP_S = 0.02
SURFACE_M = -0.2
"""The vehicle does not leave the water."""


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """Velocities that a pilot asks for.

    Attributes:
        ahead_mps, port_mps, up_mps: along the vehicle's level axes.
        turn_rps: of the heading, to port.

    Raises:
        SonarSimError: one of them is not finite; names it.
    """

    ahead_mps: float = 0.0
    port_mps: float = 0.0
    up_mps: float = 0.0
    turn_rps: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            if not math.isfinite(value := getattr(self, field.name)):
                raise SonarSimError(f"a command with {field.name} {value:g} is not finite")


class DrivenBody:
    """A level vehicle without weight that follows commands as a first-order lag.

    It passes through objects; only the water's surface holds it.

    Args:
        pose: at the beginning; its roll and pitch are left out.

    Attributes:
        pose: map_T_base.
        velocity_mps, turn_rates_rps: body frame, (3,).
    """

    def __init__(self, pose: FramePose) -> None:
        self.place(pose)

    def place(self, pose: FramePose) -> None:
        """Put it somewhere, at rest."""
        ahead = pose.rotation[:, 0]
        self._yaw_rad = float(np.arctan2(ahead[1], ahead[0]))
        self._position_m = np.array(pose.position_m, dtype=np.float64)
        self.velocity_mps = np.zeros(3)
        self.turn_rates_rps = np.zeros(3)

    @property
    def pose(self) -> FramePose:
        """The base in the map."""
        return FramePose(self._position_m.copy(), rotation_of(0.0, 0.0, self._yaw_rad))

    def advance(self, duration_s: float, command: DriveCommand) -> None:
        """Drive on for a while.

        Args:
            duration_s: from now on.
            command: during it.
        """
        asked = np.array([command.ahead_mps, command.port_mps, command.up_mps])
        steps = max(1, int(np.ceil(duration_s / MAX_STEP_S - 1e-9)))
        step_s = duration_s / steps
        kept = np.exp(-step_s / LAG_S)
        for _ in range(steps):
            self.velocity_mps = asked + kept * (self.velocity_mps - asked)
            turn_rps = command.turn_rps + kept * (self.turn_rates_rps[2] - command.turn_rps)
            self.turn_rates_rps = np.array([0.0, 0.0, turn_rps])
            middle = rotation_of(0.0, 0.0, self._yaw_rad + 0.5 * turn_rps * step_s)
            self._position_m = self._position_m + middle @ self.velocity_mps * step_s
            self._yaw_rad += turn_rps * step_s
            if self._position_m[2] > SURFACE_M:
                self._position_m[2] = SURFACE_M
                self.velocity_mps[2] = min(self.velocity_mps[2], 0.0)
