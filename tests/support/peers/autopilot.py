"""A fake autopilot whose messages pymavlink encodes."""

import math
from typing import Any

from pymavlink.dialects.v20 import common

NAN = math.nan
UNKNOWN_COVARIANCE = [NAN] + [0.0] * 20


class Autopilot:
    """One MAVLink system; every method returns the bytes of one message.

    Args:
        system: its id.
        component: of it.
        version: of the protocol, 1 or 2.
        boot_ms: its clock; set it to let time pass, jump or restart.
    """

    def __init__(
        self, system: int = 1, component: int = 1, version: int = 2, boot_ms: int = 5000
    ) -> None:
        self.boot_ms = boot_ms
        self._v1 = version == 1
        self.codec: Any = common.MAVLink(None, srcSystem=system, srcComponent=component)

    def packed(self, message: Any) -> bytes:
        data = bytes(message.pack(self.codec, force_mavlink1=self._v1))
        self.codec.seq = (self.codec.seq + 1) % 256
        return data

    def heartbeat(self) -> bytes:
        return self.packed(common.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3))

    def attitude(self, rpy_rad: tuple[float, ...], rates: tuple[float, ...] = (0, 0, 0)) -> bytes:
        return self.packed(common.MAVLink_attitude_message(self.boot_ms, *rpy_rad, *rates))

    def attitude_quaternion(
        self, wxyz: tuple[float, ...], rates: tuple[float, ...] = (0, 0, 0)
    ) -> bytes:
        message = common.MAVLink_attitude_quaternion_message(self.boot_ms, *wxyz, *rates)
        return self.packed(message)

    def local_position(
        self, ned_m: tuple[float, ...], velocity_ned_mps: tuple[float, ...] = (0, 0, 0)
    ) -> bytes:
        message = common.MAVLink_local_position_ned_message(self.boot_ms, *ned_m, *velocity_ned_mps)
        return self.packed(message)

    def global_position(self, **changes: int) -> bytes:
        fields = {
            "lat": 473_977_418,
            "lon": 85_455_939,
            "alt": 488_000,
            "relative_alt": 0,
            "vx": 0,
            "vy": 0,
            "vz": 0,
            "hdg": 9000,
        }
        message = common.MAVLink_global_position_int_message(self.boot_ms, **(fields | changes))
        return self.packed(message)

    def imu(self, kind: str, force_frd_mps2: tuple[float, ...], updated: int = 7) -> bytes:
        """A measured acceleration; of HIGHRES_IMU in m/s2, of the others in thousandths of g."""
        still = (0,) * 6
        if kind == "HIGHRES_IMU":
            tail = (0.0, 0.0, 0.0, 0.0, updated)
            return self.packed(
                common.MAVLink_highres_imu_message(
                    self.boot_ms * 1000, *force_frd_mps2, *still, *tail
                )
            )
        milli_g = [round(axis / 9.80665e-3) for axis in force_frd_mps2]
        make = getattr(common, f"MAVLink_{kind.lower()}_message")
        stamp = self.boot_ms * (1000 if kind == "RAW_IMU" else 1)
        return self.packed(make(stamp, *milli_g, *still))

    def pressure(self, hpa: float) -> bytes:
        return self.packed(common.MAVLink_scaled_pressure2_message(self.boot_ms, hpa, 0.0, 1500))

    def distance(self, cm: int, orientation: int = 25) -> bytes:
        message = common.MAVLink_distance_sensor_message(
            self.boot_ms, 20, 5000, cm, 1, 0, orientation, 255
        )
        return self.packed(message)

    def odometry(self, **changes: Any) -> bytes:
        fields: dict[str, Any] = {
            "time_usec": self.boot_ms * 1000,
            "frame_id": 1,
            "child_frame_id": 12,
            "x": 1.0,
            "y": 2.0,
            "z": 3.0,
            "q": [1.0, 0.0, 0.0, 0.0],
            "vx": 0.1,
            "vy": 0.2,
            "vz": 0.3,
            "rollspeed": 0.01,
            "pitchspeed": 0.02,
            "yawspeed": 0.03,
            "pose_covariance": UNKNOWN_COVARIANCE,
            "velocity_covariance": UNKNOWN_COVARIANCE,
            "reset_counter": 0,
            "estimator_type": 3,
            "quality": 80,
        }
        return self.packed(common.MAVLink_odometry_message(**(fields | changes)))
