"""A navigation fix, as all odometry formats take it, and their rates.

The simulator's map is ENU and its base FLU; vehicles send NED and FRD.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oculus_driver.sound_speed import pressure_bar_at
from sonar_sim.geometry.pose import FramePose, quaternion_of
from sonar_sim.scene.vehicle import (
    OdometryErrors,
    OdometrySample,
    Vehicle,
    metres_per_degree,
)
from sonar_sim.scene.water import Water

NED_R_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_R_FLU = np.diag([1.0, -1.0, -1.0])

ATMOSPHERE_BAR = 1.01325


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """One record of the navigation on its way out.

    Attributes:
        sample: what was measured.
        valid_ns, sent_ns: Unix time of its validity and of its sending.
        boot_s: of its validity, seconds since the vehicle's power-up.
        altitude_m: of the vehicle above what is below it; None where nothing is.
        vehicle: source of the fix.
        water: which it is in.
    """

    sample: OdometrySample
    valid_ns: int
    sent_ns: int
    boot_s: float
    altitude_m: float | None
    vehicle: Vehicle
    water: Water

    @property
    def errors(self) -> OdometryErrors:
        """Errors that the navigation reports of itself."""
        return self.vehicle.errors

    @property
    def position_ned_m(self) -> NDArray[np.float64]:
        """North, east, down, (3,)."""
        ned: NDArray[np.float64] = NED_R_ENU @ self.sample.pose.position_m
        return ned

    @property
    def ned_R_frd(self) -> NDArray[np.float64]:  # noqa: N802 frames are named
        """Attitude, (3, 3)."""
        return ned_R_frd(self.sample.pose)

    @property
    def quaternion_ned_frd(self) -> NDArray[np.float64]:
        """Attitude as (w, x, y, z)."""
        return quaternion_of(self.ned_R_frd)

    @property
    def roll_pitch_yaw_rad(self) -> tuple[float, float, float]:
        """Attitude in aviation's angles: roll to starboard, nose up, clockwise from north."""
        return angles_rad(self.ned_R_frd)

    @property
    def heading_deg(self) -> float:
        """Compass heading, 0 to 360."""
        return math.degrees(self.roll_pitch_yaw_rad[2]) % 360.0

    @property
    def velocity_frd_mps(self) -> NDArray[np.float64]:
        """Velocity of the body in its own axes, (3,)."""
        frd: NDArray[np.float64] = FRD_R_FLU @ self.sample.velocity_mps
        return frd

    @property
    def velocity_ned_mps(self) -> NDArray[np.float64]:
        """Velocity of the body in the world's axes, (3,)."""
        ned: NDArray[np.float64] = self.ned_R_frd @ self.velocity_frd_mps
        return ned

    @property
    def rates_frd_rps(self) -> NDArray[np.float64]:
        """Turn rates about the body's axes, (3,)."""
        frd: NDArray[np.float64] = FRD_R_FLU @ self.sample.turn_rates_rps
        return frd

    @property
    def pressure_bar(self) -> float:
        """Absolute, at the depth that the navigation believes in."""
        depth_m = max(0.0, float(self.position_ned_m[2]))
        return ATMOSPHERE_BAR + pressure_bar_at(depth_m, self.water.salinity_ppt)

    @property
    def latitude_longitude_deg(self) -> tuple[float, float]:
        """On WGS-84, good to kilometres from the map's origin."""
        north_per_deg_m, east_per_deg_m = metres_per_degree(self.vehicle.latitude_deg)
        north_m, east_m, _ = self.position_ned_m
        return (
            self.vehicle.latitude_deg + float(north_m) / north_per_deg_m,
            self.vehicle.longitude_deg + float(east_m) / east_per_deg_m,
        )


def ned_R_frd(pose: FramePose) -> NDArray[np.float64]:  # noqa: N802 frames are named
    """Attitude of a base in the map, (3, 3), from FRD to NED."""
    rotation: NDArray[np.float64] = NED_R_ENU @ pose.rotation @ FRD_R_FLU
    return rotation


def angles_rad(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation Rz(yaw) Ry(pitch) Rx(roll), (3, 3)."""
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        math.asin(float(np.clip(-rotation[2, 0], -1.0, 1.0))),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


EARLY = 1e-6


class RateLimiter:
    """Decides when a message is due.

    Args:
        period_s: between two of them.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s: float | None = None

    def due(self, time_s: float) -> bool:
        """Whether it is due now; it then counts as sent."""
        if self._due_s is not None and time_s < self._due_s - EARLY:
            return False
        late = self._due_s is None or time_s > self._due_s + self._period_s
        self._due_s = (time_s if late or self._due_s is None else self._due_s) + self._period_s
        return True
