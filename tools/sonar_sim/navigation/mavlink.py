"""MAVLink 2 as autopilots send it; one datagram a fix, several messages in it.

An ArduSub vehicle sends no covariance and no ODOMETRY message; PX4 sends ODOMETRY.
"""

import math

from pymavlink.dialects.v20 import common as dialect

from sonar_sim.navigation.fix import ATMOSPHERE_BAR, Fix, RateLimiter

AUTOPILOT = 1
"""System and component id."""
HEARTBEAT_S = 1.0
MILLISECONDS_WRAP = 1 << 32
HUNDREDTHS_A_TURN = 36_000
GOOD = 100
"""Quality of an estimate, percent."""


class _Autopilot:
    """Packs messages and sends a heartbeat now and then."""

    def __init__(self, kind: int) -> None:
        self._link = dialect.MAVLink(None, srcSystem=AUTOPILOT, srcComponent=AUTOPILOT)
        self._kind = kind
        self._heartbeat = RateLimiter(HEARTBEAT_S)

    def _signs_of_life(self, fix: Fix) -> bytes:
        if not self._heartbeat.due(fix.boot_s):
            return b""
        heartbeat = dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_SUBMARINE,
            self._kind,
            dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            0,
            dialect.MAV_STATE_ACTIVE,
            3,
        )
        clock = dialect.MAVLink_system_time_message(fix.sent_ns // 1000, _boot_ms(fix))
        return self._packed(heartbeat) + self._packed(clock)

    def _packed(self, message: dialect.MAVLink_message) -> bytes:
        data = bytes(message.pack(self._link))
        self._link.seq = (self._link.seq + 1) % 256
        return data


class Px4(_Autopilot):
    """ODOMETRY with covariances: world NED, body FRD, microseconds since boot."""

    def __init__(self) -> None:
        super().__init__(dialect.MAV_AUTOPILOT_PX4)

    def encode(self, fix: Fix) -> list[bytes]:
        """Return one datagram."""
        errors = fix.errors
        attitude_rad = math.radians(errors.attitude_noise_deg)
        rate_rps = math.radians(errors.turn_rate_noise_dps)
        message = dialect.MAVLink_odometry_message(
            round(fix.boot_s * 1e6),
            dialect.MAV_FRAME_LOCAL_NED,
            dialect.MAV_FRAME_BODY_FRD,
            *map(float, fix.position_ned_m),
            [float(number) for number in fix.quaternion_ned_frd],
            *map(float, fix.velocity_frd_mps),
            *map(float, fix.rates_frd_rps),
            _triangle(errors.position_noise_m, attitude_rad),
            _triangle(errors.velocity_noise_mps, rate_rps),
            reset_counter=0,
            estimator_type=dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
            quality=GOOD,
        )
        return [self._signs_of_life(fix) + self._packed(message)]


class ArduSub(_Autopilot):
    """What a BlueROV2 sends: position, attitude, global position and pressure; no covariance.

    Args:
        positions: False omits both positions, as a vehicle without a DVL does.
    """

    def __init__(self, *, positions: bool = True) -> None:
        super().__init__(dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)
        self._positions = positions

    def encode(self, fix: Fix) -> list[bytes]:
        """Return one datagram."""
        boot_ms = _boot_ms(fix)
        velocity = [float(part) for part in fix.velocity_ned_mps]
        position = dialect.MAVLink_local_position_ned_message(
            boot_ms, *map(float, fix.position_ned_m), *velocity
        )
        attitude = dialect.MAVLink_attitude_message(
            boot_ms, *fix.roll_pitch_yaw_rad, *map(float, fix.rates_frd_rps)
        )
        pressure = dialect.MAVLink_scaled_pressure2_message(
            boot_ms,
            1e3 * fix.pressure_bar,
            1e3 * (fix.pressure_bar - ATMOSPHERE_BAR),
            round(100.0 * fix.water.temperature_c),
        )
        messages = [attitude, pressure]
        if self._positions:
            messages = [position, attitude, _global_position(fix, boot_ms, velocity), pressure]
        return [self._signs_of_life(fix) + b"".join(map(self._packed, messages))]


def _global_position(fix: Fix, boot_ms: int, velocity_mps: list[float]) -> dialect.MAVLink_message:
    latitude_deg, longitude_deg = fix.latitude_longitude_deg
    height_mm = round(-1e3 * float(fix.position_ned_m[2]))
    return dialect.MAVLink_global_position_int_message(
        boot_ms,
        round(1e7 * latitude_deg),
        round(1e7 * longitude_deg),
        height_mm,
        height_mm,
        *(round(100.0 * part) for part in velocity_mps),
        round(100.0 * fix.heading_deg) % HUNDREDTHS_A_TURN,
    )


def _boot_ms(fix: Fix) -> int:
    return round(fix.boot_s * 1e3) % MILLISECONDS_WRAP


def _triangle(linear: float, angular: float) -> list[float]:
    """Upper triangle of a diagonal covariance, row by row; NaN first where nothing is known."""
    if linear == 0.0:
        return [math.nan] + [0.0] * 20
    variances = [linear**2] * 3 + [angular**2] * 3
    return [
        variances[row] if row == column else 0.0 for row in range(6) for column in range(row, 6)
    ]
