"""The native odometry record: one MessagePack map, both directions from one declaration.

| key | type | meaning |
|---|---|---|
| `v` | int | format version, 1 |
| `t`, `clk` | int ns, `unix`/`boot`/`arrival` | which clock the number belongs to |
| `w`, `b` | `ned`/`enu`, `frd`/`flu` | world and body conventions, never guessed |
| `p`, `q` | 3 floats m, 4 floats w,x,y,z | either may be absent |
| `u`, `r` | 3 floats m/s body, 3 floats rad/s body | may be absent |
| `pc`, `uc` | 21 floats | upper triangles, row by row; absent = unknown |
| `rst`, `src` | int, str | reset counter (0), sender name (empty) |

`t` may be left out where `clk` is `arrival`. Unknown keys are refused: a misspelt one would
otherwise vanish.
"""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mapperd.frames import BODY_TO_FLU, WORLD_TO_ENU, Body, World, orientation_to_map
from mapperd.odometry.records import Clock, Odometry
from mapperd.reject import Reject

__all__ = ["MAX_RECORD_BYTES", "NativeRecord", "decode_native", "encode_native"]

MAX_RECORD_BYTES = 2048
"""A full record takes about 700 bytes."""

MAX_DISTANCE_M = 1e7  # a quarter of the way around the Earth
MAX_SPEED_MPS = 1e3
MAX_RATE_RADPS = 1e3
MAX_COVARIANCE = 1e12
QUATERNION_TOLERANCE = 0.01  # on the norm: text with three digits passes, a wrong field does not
ZERO_NORM = 1e-6

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
    if len(data) > MAX_RECORD_BYTES:
        return Reject("too_long", f"{len(data)} bytes; a record has at most {MAX_RECORD_BYTES}")
    try:
        wire = _DECODER.decode(data)
    except msgspec.ValidationError as error:
        return Reject("wrong_shape", str(error))
    except ValueError as error:  # malformed MessagePack, or text that is not UTF-8
        return Reject("not_msgpack", str(error))
    return _problem(wire) or _converted(wire)


def _problem(wire: NativeRecord) -> Reject | None:
    """The first thing wrong with a well-formed record."""
    if wire.v != 1:
        return Reject("version", f"version {wire.v}; this program reads 1")
    if wire.t is None and wire.clk != "arrival":
        return Reject("no_stamp", f"no t, though clk is {wire.clk}")
    limits: tuple[tuple[str, tuple[float, ...] | None, float], ...] = (
        ("p", wire.p, MAX_DISTANCE_M),
        ("q", wire.q, 1e3),
        ("u", wire.u, MAX_SPEED_MPS),
        ("r", wire.r, MAX_RATE_RADPS),
        ("pc", wire.pc, MAX_COVARIANCE),
        ("uc", wire.uc, MAX_COVARIANCE),
    )
    for key, numbers, limit in limits:
        if numbers is not None and (bad := _bad_numbers(key, numbers, limit)):
            return bad
    return _bad_quaternion(wire.q) or _bad_variance(wire)


def _bad_numbers(key: str, numbers: tuple[float, ...], limit: float) -> Reject | None:
    values = np.abs(numbers)
    if not np.isfinite(values).all():
        return Reject("not_finite", f"{key} holds NaN or infinity")
    if (values > limit).any():
        return Reject("out_of_range", f"{key} holds {values.max():g}; at most {limit:g}")
    return None


def _bad_quaternion(quaternion: tuple[float, ...] | None) -> Reject | None:
    if quaternion is None:
        return None
    norm = float(np.linalg.norm(quaternion))
    if norm < ZERO_NORM:
        return Reject("zero_quaternion", "q is zero: no orientation")
    if abs(norm - 1) > QUATERNION_TOLERANCE:
        return Reject("unnormalised_quaternion", f"q has the norm {norm:.4g}, not 1")
    return None


def _bad_variance(wire: NativeRecord) -> Reject | None:
    for key, triangle in (("pc", wire.pc), ("uc", wire.uc)):
        if triangle is not None and (np.diag(_symmetric(triangle)) < 0).any():
            return Reject("negative_variance", f"{key} has a variance below 0")
    return None


def _converted(wire: NativeRecord) -> Odometry:
    world, body = WORLD_TO_ENU[wire.w], BODY_TO_FLU[wire.b]
    return Odometry(
        stamp_ns=wire.t or 0,
        clock=wire.clk,
        position_m=_turned(world, wire.p),
        map_q_base=_orientation(wire.q, wire.w, wire.b),
        velocity_mps=_turned(body, wire.u),
        rate_radps=_turned(body, wire.r),
        pose_covariance=_turned_covariance(world, wire.pc),
        twist_covariance=_turned_covariance(body, wire.uc),
        reset_count=wire.rst,
        source=wire.src,
    )


def _orientation(numbers: tuple[float, ...] | None, world: World, body: Body) -> Floats | None:
    if numbers is None:
        return None
    quaternion = orientation_to_map(numbers, world, body)
    return np.asarray(quaternion / np.linalg.norm(quaternion), dtype=np.float64)


def _turned(rotation: Floats, numbers: tuple[float, ...] | None) -> Floats | None:
    return None if numbers is None else rotation @ np.array(numbers, dtype=np.float64)


def _turned_covariance(rotation: Floats, triangle: tuple[float, ...] | None) -> Floats | None:
    if triangle is None:
        return None
    both = np.kron(np.eye(2), rotation)  # linear block, angular block
    return np.asarray(both @ _symmetric(triangle) @ both.T, dtype=np.float64)


def _symmetric(triangle: tuple[float, ...]) -> Floats:
    """(6, 6) from the 21 numbers of its upper triangle, row by row."""
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = triangle
    return np.asarray(matrix + np.triu(matrix, 1).T, dtype=np.float64)
