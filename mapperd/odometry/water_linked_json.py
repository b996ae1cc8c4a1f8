"""The TCP JSON protocol of Water Linked DVLs: one report a line, port 16171."""

import msgspec
from msgspec import Struct

from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import Odometry
from mapperd.odometry.water_linked import OVERHEATING, Position, Velocity
from mapperd.reject import Reject

__all__ = ["MAX_LINE_BYTES", "read_water_linked_json"]

MAX_LINE_BYTES = 16384
"""A velocity report takes about 1300 bytes."""

MAJOR = "json_v3"


class _Head(Struct):
    type: str
    format: str


class _Velocity(Struct):
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


class _Position(Struct):
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
_VELOCITY = msgspec.json.Decoder(_Velocity)
_POSITION = msgspec.json.Decoder(_Position)


def read_water_linked_json(
    line: bytes,
    arrival_ns: int | None,  # noqa: ARG001 the stamp is in the report
    counters: DecoderCounters,
) -> Odometry | Reject | None:
    """Read one report. Velocity through the water and answers to commands are ignored."""
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
        return _velocity(_VELOCITY.decode(line), counters)
    if head.type == "position_local":
        wire = _POSITION.decode(line)
        place, angles = (wire.x, wire.y, wire.z), (wire.roll, wire.pitch, wire.yaw)
        return Position(wire.ts, place, wire.std, angles, wire.status).odometry()
    counters.ignore(head.type)
    return None


def _velocity(wire: _Velocity, counters: DecoderCounters) -> Odometry | Reject | None:
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
