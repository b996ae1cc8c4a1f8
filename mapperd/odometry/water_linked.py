"""Reports of Water Linked DVLs (A50, A125), by TCP JSON or serial sentences.

Fields, units and axes are those of the maker's pages "DVL A50/A125 TCP JSON API" and "serial
protocol". Reports are in the frame of the DVL, or of the vehicle if a mounting rotation offset is
set in the DVL: x forward, y to starboard, z down. Positions refer to the DVL's pose at its last
reset. Times of velocities are in microseconds, those of positions in seconds; before the DVL's
clock is set their origin is arbitrary.

The serial protocol of Water Linked DVLs: sentences such as `wrz,...*50`.

The checksum is CRC-8 (polynomial 0x07, start 0) of all before the star, two lower-case hex digits.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mapperd.errors import Reject
from mapperd.geometry.frames import BODY_TO_FLU, WORLD_TO_ENU, rotation_from_rpy
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import (
    MAX_COVARIANCE,
    MAX_DISTANCE_M,
    MAX_SPEED_MPS,
    UNKNOWN_VARIANCE,
    Clock,
    Odometry,
    bad_number,
    bad_numbers,
    linear_covariance,
    orientation,
    turned,
    turned_covariance,
)

__all__ = [
    "MAX_JSON_LINE_BYTES",
    "MAX_SERIAL_LINE_BYTES",
    "NO_CONFIDENCE_FOM_MPS",
    "OVERHEATING",
    "DeadReckoningReport",
    "Velocity",
    "crc8",
    "read_water_linked_json",
    "read_water_linked_serial",
]

Floats = NDArray[np.float64]

NO_CONFIDENCE_FOM_MPS = 0.4
"""Figure of merit at which the confidence is 0, as in the BlueOS extension for this DVL."""

OVERHEATING = 1
"""Bit of a velocity report's status: the DVL is about to switch off."""

SOURCE = "water_linked"
MAX_STAMP_S = 9e9
_UNIX_FROM_NS = 10**18
"""Smaller stamps, before 2001, mean that the DVL's clock was never set."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """One velocity report over ground, as on the wire.

    Attributes:
        velocity_mps: vx, vy, vz.
        valid: the DVL detected the bottom; otherwise velocity and altitude are meaningless.
        altitude_m: along z; negative if unknown.
        fom_mps: figure of merit.
        covariance: 9 numbers, (m/s)^2, row by row.
        validity_us: time at which the sound met the bottom; None from old firmware.
        sent_us: time of sending.
    """

    velocity_mps: Sequence[float]
    valid: bool
    altitude_m: float
    fom_mps: float
    covariance: Sequence[float]
    validity_us: int | None
    sent_us: int | None

    def odometry(self) -> Odometry | Reject:
        """Convert to our frames; a report without bottom gives an invalid record."""
        stamp_us = self.validity_us
        if stamp_us is not None and (
            bad := bad_number("time_of_validity", stamp_us, 0, MAX_STAMP_S * 1e6)
        ):
            return bad
        if self.sent_us is not None and (
            bad := bad_number("time_of_transmission", self.sent_us, 0, MAX_STAMP_S * 1e6)
        ):
            return bad
        stamp_ns = (stamp_us or 0) * 1000
        clock: Clock = "arrival" if stamp_us is None else _clock(stamp_ns)
        sent_ns = None if stamp_us is None or self.sent_us is None else self.sent_us * 1000
        if not self.valid:
            return Odometry(stamp_ns, clock, source=SOURCE, valid=False, sent_ns=sent_ns)
        bad = (
            bad_numbers("velocity", self.velocity_mps, MAX_SPEED_MPS)
            or bad_numbers("covariance", self.covariance, MAX_COVARIANCE)
            or bad_number("fom", self.fom_mps, 0, MAX_COVARIANCE)
            or bad_number("altitude", self.altitude_m, -MAX_DISTANCE_M, MAX_DISTANCE_M)
        )
        if bad:
            return bad
        return Odometry(
            stamp_ns,
            clock,
            velocity_mps=turned(BODY_TO_FLU["frd"], self.velocity_mps),
            twist_covariance=self._covariance(),
            source=SOURCE,
            altitude_m=None if self.altitude_m < 0 else self.altitude_m,
            confidence=max(0.0, 1.0 - self.fom_mps / NO_CONFIDENCE_FOM_MPS),
            sent_ns=sent_ns,
        )

    def _covariance(self) -> Floats | None:
        """Return the covariance (6, 6); from the figure of merit if the matrix is invalid."""
        matrix = np.array(self.covariance, dtype=np.float64)
        if matrix.size == 9 and np.diag(matrix.reshape(3, 3)).min() > 0:  # noqa: PLR2004 3 x 3
            matrix = matrix.reshape(3, 3)
        else:
            matrix = self.fom_mps**2 * np.eye(3)
        return turned_covariance(BODY_TO_FLU["frd"], linear_covariance(matrix))


@dataclass(frozen=True, slots=True)
class DeadReckoningReport:
    """One dead reckoning report, as on the wire.

    Attributes:
        stamp_s: time of the report.
        position_m: x, y, z relative to the reset.
        std_m: standard deviation of the position.
        rpy_deg: roll, pitch, yaw; yaw relative to the reset.
        status: 0 if there is no problem.
    """

    stamp_s: float
    position_m: Sequence[float]
    std_m: float
    rpy_deg: Sequence[float]
    status: int

    def odometry(self) -> Odometry | Reject:
        """Convert to our frames; a report with a problem gives an invalid record."""
        bad = bad_number("ts", self.stamp_s, 0, MAX_STAMP_S)
        if bad:
            return bad
        stamp_ns = round(self.stamp_s * 1e9)
        clock = _clock(stamp_ns)
        if self.status != 0:
            return Odometry(stamp_ns, clock, source=SOURCE, valid=False, north_referenced=False)
        bad = (
            bad_numbers("position", self.position_m, MAX_DISTANCE_M)
            or bad_number("std", self.std_m, 0, MAX_DISTANCE_M)
            or bad_numbers("angles", self.rpy_deg, 360)
        )
        if bad:
            return bad
        variance = min(self.std_m**2, UNKNOWN_VARIANCE)
        roll, pitch, yaw = self.rpy_deg
        return Odometry(
            stamp_ns,
            clock,
            position_m=turned(WORLD_TO_ENU["local_frd"], self.position_m),
            map_q_base=orientation(rotation_from_rpy(roll, pitch, yaw), "local_frd", "frd"),
            pose_covariance=np.diag([variance] * 3 + [UNKNOWN_VARIANCE] * 3),
            source=SOURCE,
            north_referenced=False,
        )


def _clock(stamp_ns: int) -> Clock:
    return "unix" if stamp_ns >= _UNIX_FROM_NS else "boot"


MAX_JSON_LINE_BYTES = 16384
"""A velocity report takes about 1300 bytes."""

MAJOR = "json_v3"


class _Head(Struct):
    type: str
    format: str


class _VelocityMessage(Struct):
    vx: float
    vy: float
    vz: float
    fom: float
    altitude: float
    velocity_valid: bool
    covariance: tuple[tuple[float, float, float], ...] = ()
    status: int = 0
    time_of_validity: int | None = None
    time_of_transmission: int | None = None
    tracking_mode: str = "bottom"


class _PositionMessage(Struct):
    ts: float
    x: float
    y: float
    z: float
    std: float
    roll: float
    pitch: float
    yaw: float
    status: int


_HEAD = msgspec.json.Decoder(_Head)
_VELOCITY = msgspec.json.Decoder(_VelocityMessage)
_POSITION = msgspec.json.Decoder(_PositionMessage)


def read_water_linked_json(
    line: bytes,
    arrival_ns: int | None,  # noqa: ARG001 the stamp is in the report
    counters: DecoderCounters,
) -> Odometry | Reject | None:
    """Decode one report; velocity through the water and answers to commands are ignored."""
    try:
        return _report(line, counters)
    except msgspec.ValidationError as error:
        return Reject("wrong_shape", str(error))
    except (ValueError, RecursionError) as error:  # malformed JSON, not UTF-8, or too deep
        return Reject("not_json", str(error))


def _report(line: bytes, counters: DecoderCounters) -> Odometry | Reject | None:
    head = _HEAD.decode(line)
    counters.heard(head.type, len(line))
    if head.format.partition(".")[0] != MAJOR:
        return Reject("version", f"format {head.format[:40]!r}; this program reads {MAJOR}")
    if head.type == "velocity":
        return _json_velocity(_VELOCITY.decode(line), counters)
    if head.type == "position_local":
        wire = _POSITION.decode(line)
        place, angles = (wire.x, wire.y, wire.z), (wire.roll, wire.pitch, wire.yaw)
        return DeadReckoningReport(wire.ts, place, wire.std, angles, wire.status).odometry()
    counters.ignore(head.type)
    return None


def _json_velocity(wire: _VelocityMessage, counters: DecoderCounters) -> Odometry | Reject | None:
    if wire.status & OVERHEATING:
        counters.warnings["overheating"] += 1
    if wire.tracking_mode != "bottom":  # through the water, not over ground
        counters.ignore("velocity_water")
        return None
    return Velocity(
        (wire.vx, wire.vy, wire.vz),
        wire.velocity_valid,
        wire.altitude,
        wire.fom,
        [number for row in wire.covariance for number in row],
        wire.time_of_validity,
        wire.time_of_transmission,
    ).odometry()


MAX_SERIAL_LINE_BYTES = 1024
"""The longest sentence takes about 250 bytes."""

VELOCITY_FIELDS = 11
POSITION_FIELDS = 9


def _crc8_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ 0x07 if byte & 0x80 else byte << 1
    return byte & 0xFF


_TABLE = bytes(_crc8_of_byte(byte) for byte in range(256))


def crc8(data: bytes) -> int:
    """CRC-8, polynomial x^8 + x^2 + x + 1, start 0, not reflected."""
    *_, crc = accumulate(data, lambda crc, byte: _TABLE[crc ^ byte], initial=0)
    return crc


def read_water_linked_serial(
    line: bytes,
    arrival_ns: int | None,  # noqa: ARG001 the stamp is in the sentence
    counters: DecoderCounters,
) -> Odometry | Reject | None:
    """Decode one sentence; all but `wrz` and `wrp` are ignored."""
    body, _, check = line.rpartition(b"*")
    if not body.startswith(b"wr") or len(check) != 2:  # noqa: PLR2004 hex digits
        return Reject("not_a_sentence", f"{len(line)} bytes that are no wr...*hh")
    if check != b"%02x" % crc8(body):
        return Reject(
            "bad_checksum", f"received {check.decode('latin-1')!r}, computed {crc8(body):02x}"
        )
    name, *fields = body.decode("latin-1").split(",")
    counters.heard(name, len(line))
    reader = _READERS.get(name)
    if reader is None:
        counters.ignore(name)
        return None
    try:
        return reader(fields, counters)
    except ValueError as error:
        return Reject("wrong_shape", f"{name}: {error}")


def _serial_velocity(fields: list[str], counters: DecoderCounters) -> Odometry | Reject:
    if len(fields) != VELOCITY_FIELDS or fields[3] not in ("y", "n"):
        raise ValueError(f"{VELOCITY_FIELDS} fields with y or n were expected")
    if int(fields[10]) & OVERHEATING:
        counters.warnings["overheating"] += 1
    return Velocity(
        [_number(text) for text in fields[:3]],
        fields[3] == "y",
        _number(fields[4]),
        _number(fields[5]),
        [_number(text) for text in fields[6].split(";")],
        int(fields[7]),
        int(fields[8]),
    ).odometry()


def _position(fields: list[str], _counters: DecoderCounters) -> Odometry | Reject:
    if len(fields) != POSITION_FIELDS:
        raise ValueError(f"{POSITION_FIELDS} fields were expected")
    stamp_s, x, y, z, std, roll, pitch, yaw = (_number(text) for text in fields[:8])
    return DeadReckoningReport(
        stamp_s, (x, y, z), std, (roll, pitch, yaw), int(fields[8])
    ).odometry()


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text!r} is not a number")
    return number


_READERS: dict[str, Callable[[list[str], DecoderCounters], Odometry | Reject]] = {
    "wrz": _serial_velocity,
    "wrp": _position,
}
