"""The native record as a line of JSON with the same keys: for testing by hand."""

import msgspec

from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.native import NativeRecord, odometry_of
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["MAX_LINE_BYTES", "encode_native_json", "read_native_json"]

MAX_LINE_BYTES = 4096
"""A full record takes about 1500 bytes."""

_DECODER = msgspec.json.Decoder(NativeRecord)
_ENCODER = msgspec.json.Encoder()


def encode_native_json(record: NativeRecord) -> bytes:
    """One line, with its end; what is None stays absent."""
    return _ENCODER.encode(record) + b"\n"


def read_native_json(
    line: bytes,
    arrival_ns: int | None,  # noqa: ARG001 the stamp is in the record
    counters: DecoderCounters,
) -> Odometry | Reject:
    """Read one line."""
    try:
        wire = _DECODER.decode(line)
    except msgspec.ValidationError as error:
        return Reject("wrong_shape", str(error))
    except ValueError as error:  # malformed JSON, or text that is not UTF-8
        return Reject("not_json", str(error))
    counters.heard("record", len(line))
    return odometry_of(wire)
