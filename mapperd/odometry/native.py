"""The native odometry record: one MessagePack map, both directions from one declaration.

| key | type | meaning |
|---|---|---|
| `v` | int | format version, 1 |
| `t`, `clk` | int ns, `unix`/`boot`/`arrival` | which clock the number belongs to |
| `w` | `ned`/`enu`, or `local_frd`/`local_flu` of arbitrary heading | world axes, never guessed |
| `b` | `frd`/`flu` | body axes, never guessed |
| `p`, `q` | 3 floats m, 4 floats w,x,y,z | either may be absent |
| `u`, `r` | 3 floats m/s body, 3 floats rad/s body | may be absent |
| `a` | 3 floats m/s² | specific force in body axes, as an accelerometer has it; may be absent |
| `pc`, `uc` | 21 floats | upper triangles, row by row; absent = unknown |
| `rst`, `src` | int, str | reset counter (0), sender name (empty) |

`t` may be left out where `clk` is `arrival`. Unknown keys are refused: a misspelt one would
otherwise vanish.
"""

from collections.abc import Iterator
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mapperd.geometry.frames import BODY_TO_FLU, WORLD_TO_ENU, Body, World
from mapperd.odometry.convert import (
    MAX_COVARIANCE,
    MAX_DISTANCE_M,
    MAX_RATE_RADPS,
    MAX_SPEED_MPS,
    bad_numbers,
    bad_quaternion,
    bad_variance,
    orientation,
    symmetric,
    turned,
    turned_covariance,
)
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import Clock, Odometry
from mapperd.reject import Reject

__all__ = [
    "MAX_RECORD_BYTES",
    "NativeDecoder",
    "NativeRecord",
    "decode_native",
    "encode_native",
    "odometry_of",
]

MAX_RECORD_BYTES = 2048
"""A full record takes about 700 bytes."""

MAX_FORCE_MPS2 = 1e3

Numbers3 = Annotated[tuple[float, ...], Meta(min_length=3, max_length=3)]
Numbers4 = Annotated[tuple[float, ...], Meta(min_length=4, max_length=4)]
Numbers21 = Annotated[tuple[float, ...], Meta(min_length=21, max_length=21)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Floats = NDArray[np.float64]


class NativeRecord(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The record as it stands on the wire, in the sender's conventions."""

    v: int
    clk: Clock
    w: World
    b: Body
    t: Count | None = None
    p: Numbers3 | None = None
    q: Numbers4 | None = None
    u: Numbers3 | None = None
    r: Numbers3 | None = None
    a: Numbers3 | None = None
    pc: Numbers21 | None = None
    uc: Numbers21 | None = None
    rst: Count = 0
    src: Annotated[str, Meta(max_length=64)] = ""


_DECODER = msgspec.msgpack.Decoder(NativeRecord)
_ENCODER = msgspec.msgpack.Encoder()


def encode_native(record: NativeRecord) -> bytes:
    """Write a record; what is None stays absent."""
    return _ENCODER.encode(record)


def decode_native(data: bytes) -> Odometry | Reject:
    """Read one record and convert it to our frames; total: any bytes give one of the two.

    Args:
        data: exactly one MessagePack map.
    """
    wire = _wire_of(data)
    return wire if isinstance(wire, Reject) else odometry_of(wire)


def _wire_of(data: bytes) -> NativeRecord | Reject:
    if len(data) > MAX_RECORD_BYTES:
        return Reject("too_long", f"{len(data)} bytes; a record has at most {MAX_RECORD_BYTES}")
    try:
        return _DECODER.decode(data)
    except msgspec.ValidationError as error:
        return Reject("wrong_shape", str(error))
    except ValueError as error:  # malformed MessagePack, or text that is not UTF-8
        return Reject("not_msgpack", str(error))


def odometry_of(wire: NativeRecord) -> Odometry | Reject:
    """A well-formed record in our frames, or what is wrong with it."""
    return _problem(wire) or _converted(wire)


def _problem(wire: NativeRecord) -> Reject | None:
    if wire.v != 1:
        return Reject("version", f"version {wire.v}; this program reads 1")
    if wire.t is None and wire.clk != "arrival":
        return Reject("no_stamp", f"no t, though clk is {wire.clk}")
    limits: tuple[tuple[str, tuple[float, ...] | None, float], ...] = (
        ("p", wire.p, MAX_DISTANCE_M),
        ("q", wire.q, 1e3),
        ("u", wire.u, MAX_SPEED_MPS),
        ("r", wire.r, MAX_RATE_RADPS),
        ("a", wire.a, MAX_FORCE_MPS2),
        ("pc", wire.pc, MAX_COVARIANCE),
        ("uc", wire.uc, MAX_COVARIANCE),
    )
    for key, numbers, limit in limits:
        if numbers is not None and (bad := bad_numbers(key, numbers, limit)):
            return bad
    if wire.q is not None and (bad := bad_quaternion(wire.q)):
        return bad
    for key, triangle in (("pc", wire.pc), ("uc", wire.uc)):
        if triangle is not None and (bad := bad_variance(key, triangle)):
            return bad
    return None


def _converted(wire: NativeRecord) -> Odometry:
    world, body = WORLD_TO_ENU[wire.w], BODY_TO_FLU[wire.b]
    return Odometry(
        stamp_ns=wire.t or 0,
        clock=wire.clk,
        position_m=None if wire.p is None else turned(world, wire.p),
        map_q_base=None if wire.q is None else orientation(wire.q, wire.w, wire.b),
        velocity_mps=None if wire.u is None else turned(body, wire.u),
        rate_radps=None if wire.r is None else turned(body, wire.r),
        pose_covariance=_covariance(world, wire.pc),
        twist_covariance=_covariance(body, wire.uc),
        reset_count=wire.rst,
        source=wire.src,
        specific_force_mps2=None if wire.a is None else turned(body, wire.a),
        north_referenced=wire.w in ("enu", "ned"),
    )


def _covariance(rotation: Floats, triangle: tuple[float, ...] | None) -> Floats | None:
    return None if triangle is None else turned_covariance(rotation, symmetric(triangle))


class NativeDecoder:
    """Datagrams of one MessagePack record each.

    Attributes:
        counters: what came in and what became of it.
    """

    def __init__(self) -> None:
        self.counters = DecoderCounters()

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:  # noqa: ARG002 the stamp is in the record
        """Take one datagram."""
        self.counters.bytes_total += len(data)
        wire = _wire_of(data)
        self.counters.heard("record", len(data), whole=isinstance(wire, NativeRecord))
        yield self.counters.out(wire if isinstance(wire, Reject) else odometry_of(wire))

    def restart(self) -> None:
        """Nothing is half received: each datagram is whole."""
