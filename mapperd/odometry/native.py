"""The native odometry record as MessagePack, as JSON, and framed for serial lines.

| key | type | meaning |
|---|---|---|
| `v` | int | format version, 1 |
| `t`, `clk` | int ns, `unix`/`boot`/`arrival` | which clock the number belongs to |
| `w` | `ned`/`enu`, or `local_frd`/`local_flu` of arbitrary heading | world axes, never guessed |
| `b` | `frd`/`flu` | body axes, never guessed |
| `p`, `q` | 3 floats m, 4 floats w,x,y,z | either may be absent |
| `u`, `r` | 3 floats m/s body, 3 floats rad/s body | may be absent |
| `a` | 3 floats m/s² | specific force in body axes, as accelerometers measure it; may be absent |
| `pc`, `uc` | 21 floats | upper triangles, row by row; absent = unknown |
| `rst`, `src` | int, str | reset counter (0), sender name (empty) |

`t` may be absent if `clk` is `arrival`. Unknown keys are errors, so that misspelt ones are found.

On a byte stream a frame is the record and its CRC-32, byte-stuffed, followed by a zero byte. The
CRC is that of Ethernet and zip (`zlib.crc32`) over the record, little endian. After any loss the
next zero byte starts a new frame.

Byte stuffing (COBS) removes zeros from the data, so that a zero can end a frame:
S. Cheshire and M. Baker, "Consistent overhead byte stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

import zlib
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mapperd.errors import Reject
from mapperd.geometry.frames import BODY_TO_FLU, WORLD_TO_ENU, Body, World
from mapperd.odometry.decoder import CountersState, DecoderCounters
from mapperd.odometry.records import (
    MAX_COVARIANCE,
    MAX_DISTANCE_M,
    MAX_RATE_RADPS,
    MAX_SPEED_MPS,
    Clock,
    Odometry,
    bad_numbers,
    bad_quaternion,
    bad_variance,
    orientation,
    symmetric,
    turned,
    turned_covariance,
)

__all__ = [
    "MAX_FRAME_BYTES",
    "MAX_LINE_BYTES",
    "MAX_RECORD_BYTES",
    "NativeDecoder",
    "NativeRecord",
    "NativeSerialDecoder",
    "cobs_decoded",
    "cobs_encoded",
    "decode_native",
    "encode_native",
    "encode_native_json",
    "encode_native_serial",
    "odometry_of",
    "read_native_json",
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
    """The record on the wire, in the sender's conventions."""

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
    """Encode a record; None values are absent."""
    return _ENCODER.encode(record)


def decode_native(data: bytes) -> Odometry | Reject:
    """Decode one record and convert it to our frames; any bytes give a record or a reject.

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
    """Return a well-formed record in our frames, or what is invalid in it."""
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
    """Decodes datagrams of one MessagePack record each.

    Attributes:
        counters: counters of this decoder.
    """

    def __init__(self) -> None:
        self.counters = DecoderCounters()

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:  # noqa: ARG002 the stamp is in the record
        """Decode one datagram."""
        self.counters.bytes_total += len(data)
        wire = _wire_of(data)
        self.counters.heard("record", len(data), whole=isinstance(wire, NativeRecord))
        yield self.counters.out(wire if isinstance(wire, Reject) else odometry_of(wire))

    def restart(self) -> None:
        """Do nothing: datagrams are never partial."""

    def state(self) -> CountersState:
        """As `Decoder.state`."""
        return self.counters.state()

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """As `Decoder.restore`."""
        self.counters.restore(msgspec.convert(state, CountersState, strict=False))


MAX_LINE_BYTES = 4096
"""A full record takes about 1500 bytes."""

_JSON_DECODER = msgspec.json.Decoder(NativeRecord)
_JSON_ENCODER = msgspec.json.Encoder()


def encode_native_json(record: NativeRecord) -> bytes:
    """Return one line with its end; None values are absent."""
    return _JSON_ENCODER.encode(record) + b"\n"


def read_native_json(
    line: bytes,
    arrival_ns: int | None,  # noqa: ARG001 the stamp is in the record
    counters: DecoderCounters,
) -> Odometry | Reject:
    """Read one line."""
    try:
        wire = _JSON_DECODER.decode(line)
    except msgspec.ValidationError as error:
        return Reject("wrong_shape", str(error))
    except ValueError as error:  # malformed JSON, or text that is not UTF-8
        return Reject("not_json", str(error))
    counters.heard("record", len(line))
    return odometry_of(wire)


_RUN = 254  # maximum bytes between two code bytes


def cobs_encoded(data: bytes) -> bytes:
    """Return the data without zero bytes, longer by one byte and one in 254; no delimiter."""
    out = bytearray()
    pieces = data.split(b"\0")
    for place, piece in enumerate(pieces):
        start = 0
        while len(piece) - start >= _RUN:
            out.append(_RUN + 1)
            out += piece[start : start + _RUN]
            start += _RUN
        # After a full run no zero follows, and none is added at the end of the data.
        if start < len(piece) or not start or place < len(pieces) - 1:
            out.append(len(piece) - start + 1)
            out += piece[start:]
    return bytes(out)


def cobs_decoded(stuffed: bytes) -> bytes | None:
    """Return the decoded data, or None if the encoding is invalid.

    Args:
        stuffed: bytes between two delimiters.
    """
    if not stuffed or 0 in stuffed:
        return None
    parts = []
    place, size = 0, len(stuffed)
    while place < size:
        code = stuffed[place]
        end = place + code
        if end > size:
            return None
        parts.append(stuffed[place + 1 : end])
        if code <= _RUN and end < size:
            parts.append(b"\0")
        place = end
    return b"".join(parts)


CRC_BYTES = 4
MAX_FRAME_BYTES = MAX_RECORD_BYTES + CRC_BYTES + MAX_RECORD_BYTES // 254 + 2


def encode_native_serial(record: NativeRecord) -> bytes:
    """Return one frame with its delimiter."""
    data = encode_native(record)
    return cobs_encoded(data + zlib.crc32(data).to_bytes(CRC_BYTES, "little")) + b"\0"


class _SerialState(NamedTuple):
    counters: CountersState
    rest: bytes
    skipping: bool


class NativeSerialDecoder:
    """Decodes frames between zero bytes, split in any way.

    Attributes:
        counters: counters of this decoder.
    """

    def __init__(self) -> None:
        self.counters = DecoderCounters()
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:  # noqa: ARG002 the stamp is in the record
        """Take the next bytes."""
        self.counters.bytes_total += len(data)
        *frames, rest = (self._rest + data).split(b"\0")
        self._rest = b""
        for frame in frames:
            if self._skipping or len(frame) > MAX_FRAME_BYTES:
                yield from self._too_long(frame)
                self._skipping = False
            elif frame:  # two delimiters in a row enclose nothing
                yield self.counters.out(self._record(frame))
        if self._skipping or len(rest) > MAX_FRAME_BYTES:
            yield from self._too_long(rest)
        else:
            self._rest = rest

    def restart(self) -> None:
        """Forget what is half received."""
        self.counters.bytes_skipped += len(self._rest)
        self._rest, self._skipping = b"", False

    def state(self) -> _SerialState:
        """As `Decoder.state`."""
        return _SerialState(self.counters.state(), self._rest, self._skipping)

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """As `Decoder.restore`."""
        counters, self._rest, self._skipping = msgspec.convert(state, _SerialState, strict=False)
        self.counters.restore(counters)

    def _record(self, frame: bytes) -> Odometry | Reject:
        data = cobs_decoded(frame)
        whole = (
            data is not None
            and len(data) > CRC_BYTES
            and zlib.crc32(data[:-CRC_BYTES]) == int.from_bytes(data[-CRC_BYTES:], "little")
        )
        self.counters.heard("record", len(frame), whole=whole)
        if data is None or not whole:
            return Reject("bad_checksum", f"{len(frame)} bytes between zeros are no whole frame")
        return decode_native(data[:-CRC_BYTES])

    def _too_long(self, piece: bytes) -> Iterator[Reject]:
        """Skip a piece of a too long frame; each such frame is one reject."""
        self.counters.bytes_skipped += len(piece)
        if not self._skipping:
            self._skipping = True
            reject = Reject("too_long", f"more than {MAX_FRAME_BYTES} bytes without a zero")
            self.counters.out(reject)
            yield reject
