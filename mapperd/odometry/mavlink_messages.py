"""Converts MAVLink messages to our frames, one function each.

Fields, units and frames: the common message set of MAVLink (mavlink.io). World frames are NED
unless the message states otherwise, body frames are FRD and angles radians.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.geometry.frames import (
    BODY_TO_FLU,
    WORLD_TO_ENU,
    World,
    compass_quaternion,
    compass_to_map,
)
from mapperd.odometry.records import (
    MAX_COVARIANCE,
    MAX_DEPTH_M,
    MAX_DISTANCE_M,
    MAX_RATE_RADPS,
    MAX_SPEED_MPS,
    GeoPoint,
    bad_number,
    bad_numbers,
    bad_quaternion,
    bad_variance,
    orientation,
    symmetric,
    turned,
    turned_covariance,
)

__all__ = ["ACCELERATIONS", "ORDER", "READERS", "Fields", "specific_force"]

Fields = dict[str, Any]
"""Fields of an `Odometry` without its time."""

Floats = NDArray[np.float64]

GRAVITY_MPS2 = 9.80665
HPA_PA = 100.0
MIN_AIR_HPA = 500.0  # minimum air pressure: an unpowered sensor reports 0
MAX_TIME_US = 9e15  # fits in 64 bits as nanoseconds
UNKNOWN_HEADING = 65535
DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
FAILED, FULL = -1, 100  # quality of ODOMETRY; 0 is unknown

WORLDS: dict[int, World] = {1: "ned", 4: "enu", 20: "local_frd", 21: "local_flu"}
"""World axes by MAV_FRAME of a pose; local frames have an arbitrary heading."""

FRD_BODIES = (12, 8, 9)
"""MAV_FRAME of a velocity: BODY_FRD and its former names BODY_NED, BODY_OFFSET_NED."""

ORDER = (
    "ODOMETRY",
    "LOCAL_POSITION_NED",
    "ATTITUDE_QUATERNION",
    "ATTITUDE",
    "GLOBAL_POSITION_INT",
)
"""Messages with the same quantity, best first."""


@dataclass(frozen=True, slots=True)
class _MavlinkOdometry:
    """The known parts of an ODOMETRY; NaN or unset parts are None."""

    position: Sequence[float] | None
    quaternion: Sequence[float] | None
    velocity: Sequence[float] | None
    rates: Sequence[float] | None
    pose_covariance: Sequence[float] | None
    velocity_covariance: Sequence[float] | None

    @classmethod
    def of(cls, m: Any) -> "_MavlinkOdometry":  # noqa: ANN401 pymavlink's message
        """Return the known parts of a message."""
        return cls(
            _known((m.x, m.y, m.z)),
            _known(m.q),
            _known((m.vx, m.vy, m.vz)),
            _known((m.rollspeed, m.pitchspeed, m.yawspeed)),
            _filled(m.pose_covariance),
            _filled(m.velocity_covariance),
        )

    def problem(self) -> Reject | None:
        """Return the first problem of the message."""
        limits = (
            ("position", self.position, MAX_DISTANCE_M),
            ("q", self.quaternion, 1e3),
            ("velocity", self.velocity, MAX_SPEED_MPS),
            ("rates", self.rates, MAX_RATE_RADPS),
            ("pose_covariance", self.pose_covariance, MAX_COVARIANCE),
            ("velocity_covariance", self.velocity_covariance, MAX_COVARIANCE),
        )
        for key, numbers, limit in limits:
            if numbers is not None and (bad := bad_numbers(key, numbers, limit)):
                return bad
        if self.quaternion is not None and (bad := bad_quaternion(self.quaternion)):
            return bad
        for key, triangle in (
            ("pose_covariance", self.pose_covariance),
            ("velocity_covariance", self.velocity_covariance),
        ):
            if triangle is not None and (bad := bad_variance(key, triangle)):
                return bad
        return None


def _odometry(m: Any, _: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    world = WORLDS.get(m.frame_id)
    if world is None or m.child_frame_id not in FRD_BODIES:
        return Reject("unknown_frame", f"frames {m.frame_id} and {m.child_frame_id}")
    if bad := bad_number("time_usec", m.time_usec, 0, MAX_TIME_US):
        return bad
    if m.quality == FAILED:
        return {"valid": False}
    known = _MavlinkOdometry.of(m)
    if bad := known.problem():
        return bad
    axes, flu, q = WORLD_TO_ENU[world], BODY_TO_FLU["frd"], known.quaternion
    return {
        "position_m": _turned(axes, known.position),
        "map_q_base": None if q is None else orientation(q, world, "frd"),
        "velocity_mps": _turned(flu, known.velocity),
        "rate_radps": _turned(flu, known.rates),
        "pose_covariance": _covariance(axes, known.pose_covariance),
        "twist_covariance": _covariance(flu, known.velocity_covariance),
        "confidence": m.quality / FULL if 0 < m.quality <= FULL else None,
        "north_referenced": world in ("ned", "enu"),
    }


def _local_position(m: Any, _: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    position, velocity = (m.x, m.y, m.z), (m.vx, m.vy, m.vz)
    return (
        bad_numbers("position", position, MAX_DISTANCE_M)
        or bad_numbers("velocity", velocity, MAX_SPEED_MPS)
        or {
            "position_m": turned(WORLD_TO_ENU["ned"], position),
            "velocity_map_mps": turned(WORLD_TO_ENU["ned"], velocity),
        }
    )


def _attitude(m: Any, _: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
    return (
        bad_numbers("angles", (m.roll, m.pitch, m.yaw), math.tau)
        or bad_numbers("rates", rates, MAX_RATE_RADPS)
        or {
            "map_q_base": compass_quaternion(*np.degrees((m.roll, m.pitch, m.yaw))),
            "rate_radps": turned(BODY_TO_FLU["frd"], rates),
        }
    )


def _attitude_quaternion(m: Any, _: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    quaternion = (m.q1, m.q2, m.q3, m.q4)
    rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
    return (
        bad_numbers("q", quaternion, 1e3)
        or bad_quaternion(quaternion)
        or bad_numbers("rates", rates, MAX_RATE_RADPS)
        or {
            "map_q_base": orientation(quaternion, "ned", "frd"),
            "rate_radps": turned(BODY_TO_FLU["frd"], rates),
        }
    )


def _global_position(m: Any, _: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    latitude_deg, longitude_deg = m.lat * 1e-7, m.lon * 1e-7
    bad = bad_number("lat", latitude_deg, -90, 90) or bad_number("lon", longitude_deg, -180, 180)
    if bad:
        return bad
    if m.lat == 0 and m.lon == 0:  # sent by autopilots before they know
        return Reject("no_fix", "latitude and longitude are 0")
    geo = GeoPoint(math.radians(latitude_deg), math.radians(longitude_deg), m.alt * 1e-3)
    known = m.hdg != UNKNOWN_HEADING
    return {
        "geo": geo,
        "velocity_map_mps": turned(WORLD_TO_ENU["ned"], (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01)),
        "heading_rad": compass_to_map(m.hdg * 0.01) if known else None,
    }


def _pressure(m: Any, settings: FormatSettings) -> Fields | Reject:  # noqa: ANN401
    if bad := bad_number("press_abs", m.press_abs, MIN_AIR_HPA, math.inf):
        return bad
    over_pa = (m.press_abs - settings.surface_pressure) * HPA_PA
    depth_m = over_pa / (settings.water_density * GRAVITY_MPS2)
    return bad_number("depth", depth_m, -11.0, MAX_DEPTH_M) or {"depth_m": depth_m}


def _distance(m: Any, _: FormatSettings) -> Fields | Reject | None:  # noqa: ANN401
    if m.orientation != DOWN:
        return None
    if not m.min_distance <= m.current_distance <= m.max_distance:
        return Reject("out_of_range", f"{m.current_distance} cm exceeds the sensor's range")
    return {"altitude_m": m.current_distance * 0.01}


ACCELERATIONS = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2")
"""Messages with an acceleration, best first; units as ArduPilot and PX4 use them."""

MG_MPS2 = GRAVITY_MPS2 / 1000
ACCELERATION_UPDATED = 0b111
MAX_ACCELERATION_MPS2 = 1e3


def specific_force(m: Any) -> Floats | Reject | None:  # noqa: ANN401
    """Return the specific force (3,) in a message of `ACCELERATIONS`, m/s2, base axes.

    Returns:
        None if the message has no new acceleration.
    """
    unit = MG_MPS2
    if m.get_type() == "HIGHRES_IMU":
        if m.fields_updated & ACCELERATION_UPDATED != ACCELERATION_UPDATED:
            return None
        unit = 1.0
    force = [unit * axis for axis in (m.xacc, m.yacc, m.zacc)]
    return bad_numbers("acc", force, MAX_ACCELERATION_MPS2) or turned(BODY_TO_FLU["frd"], force)


READERS: dict[str, Callable[[Any, FormatSettings], Fields | Reject | None]] = {
    "ODOMETRY": _odometry,
    "LOCAL_POSITION_NED": _local_position,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
    "GLOBAL_POSITION_INT": _global_position,
    "SCALED_PRESSURE2": _pressure,
    "DISTANCE_SENSOR": _distance,
}


def _known(numbers: Sequence[float]) -> Sequence[float] | None:
    """Return None if all are NaN, which marks an absent part."""
    return None if all(math.isnan(number) for number in numbers) else numbers


def _filled(triangle: Sequence[float]) -> Sequence[float] | None:
    """Return None if the first is NaN, which marks it absent, or all are 0, which is impossible."""
    return None if math.isnan(triangle[0]) or not any(triangle) else triangle


def _turned(rotation: Floats, numbers: Sequence[float] | None) -> Floats | None:
    return None if numbers is None else turned(rotation, numbers)


def _covariance(rotation: Floats, triangle: Sequence[float] | None) -> Floats | None:
    return None if triangle is None else turned_covariance(rotation, symmetric(triangle))
