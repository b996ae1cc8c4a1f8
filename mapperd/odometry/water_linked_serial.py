"""The serial protocol of Water Linked DVLs: sentences such as `wrz,...*50`.

The check is CRC-8 (polynomial 0x07, start 0) of all before the star, two lower-case hex digits.
"""

import math
from collections.abc import Callable
from itertools import accumulate

from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import Odometry
from mapperd.odometry.water_linked import OVERHEATING, Position, Velocity
from mapperd.reject import Reject

__all__ = ["MAX_LINE_BYTES", "crc8", "read_water_linked_serial"]

MAX_LINE_BYTES = 1024
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
    """Read one sentence. All but `wrz` and `wrp` are ignored."""
    body, _, check = line.rpartition(b"*")
    if not body.startswith(b"wr") or len(check) != 2:  # noqa: PLR2004 hex digits
        return Reject("not_a_sentence", f"{len(line)} bytes that are no wr...*hh")
    if check != b"%02x" % crc8(body):
        return Reject("bad_checksum", f"says {check.decode('latin-1')!r}, is {crc8(body):02x}")
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


def _velocity(fields: list[str], counters: DecoderCounters) -> Odometry | Reject:
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
    return Position(stamp_s, (x, y, z), std, (roll, pitch, yaw), int(fields[8])).odometry()


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text!r} is no number")
    return number


_READERS: dict[str, Callable[[list[str], DecoderCounters], Odometry | Reject]] = {
    "wrz": _velocity,
    "wrp": _position,
}
