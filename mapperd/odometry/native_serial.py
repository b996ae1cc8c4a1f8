"""The native record on a stream of bytes: record and CRC-32, stuffed, ended by a zero byte.

The CRC is that of Ethernet and zip (`zlib.crc32`) over the record, little endian. After any loss
the next zero byte begins a new frame.
"""

import zlib
from collections.abc import Iterator

from mapperd.odometry.cobs import cobs_decoded, cobs_encoded
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.native import MAX_RECORD_BYTES, NativeRecord, decode_native, encode_native
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["MAX_FRAME_BYTES", "NativeSerialDecoder", "encode_native_serial"]

CRC_BYTES = 4
MAX_FRAME_BYTES = MAX_RECORD_BYTES + CRC_BYTES + MAX_RECORD_BYTES // 254 + 2


def encode_native_serial(record: NativeRecord) -> bytes:
    """One frame, with its delimiter behind it."""
    data = encode_native(record)
    return cobs_encoded(data + zlib.crc32(data).to_bytes(CRC_BYTES, "little")) + b"\0"


class NativeSerialDecoder:
    """Frames between zero bytes, however the stream was split.

    Attributes:
        counters: what came in and what became of it.
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
            elif frame:  # between two delimiters in a row is nothing
                yield self.counters.out(self._record(frame))
        if self._skipping or len(rest) > MAX_FRAME_BYTES:
            yield from self._too_long(rest)
        else:
            self._rest = rest

    def restart(self) -> None:
        """Forget what is half received."""
        self.counters.bytes_skipped += len(self._rest)
        self._rest, self._skipping = b"", False

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
        """Skip a piece of a frame; one reject for each such frame."""
        self.counters.bytes_skipped += len(piece)
        if not self._skipping:
            self._skipping = True
            reject = Reject("too_long", f"more than {MAX_FRAME_BYTES} bytes without a zero")
            self.counters.out(reject)
            yield reject
