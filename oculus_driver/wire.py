"""Messages of the Oculus protocol: layouts, ids, flags and limits.

Every layout starts with the 16-byte header. Offsets count from the first byte of the message.
All structures are little-endian and packed. The simulator encodes with the declarations that the
driver decodes with.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any, Final

from oculus_driver.errors import EncodeError, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping


U8 = "B"
U16 = "H"
U32 = "I"
F64 = "d"


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a layout.

    Attributes:
        name: unique within the layout; ends with the unit, if there is one.
        offset: bytes from the start of the message; checked against the preceding fields.
        code: `struct` code of one value, such as "H" or "6s".
        count: number of values; more than one value is unpacked as a tuple.
        default: packed if no value is given.
    """

    name: str
    offset: int
    code: str
    count: int = 1
    default: Any = 0


@dataclass(frozen=True)
class Layout:
    """A packed little-endian structure without gaps.

    Raises:
        ProtocolError: on construction, if the offset of a field or the total size does not equal
            the sum of the preceding fields. A typing error in a declaration fails at import.
    """

    name: str
    size: int
    fields: tuple[Field, ...]
    _struct: struct.Struct = field(init=False, repr=False, compare=False)
    _offsets: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        end = 0
        for item in self.fields:
            if item.offset != end:
                raise ProtocolError(f"{self.name}.{item.name} declared at {item.offset}, is {end}")
            end += struct.calcsize("<" + item.code) * item.count
        if end != self.size:
            raise ProtocolError(f"{self.name} declared with {self.size} bytes, has {end}")
        codes = "<" + "".join(item.code * item.count for item in self.fields)
        offsets = {item.name: item.offset for item in self.fields}
        if len(offsets) != len(self.fields):
            raise ProtocolError(f"{self.name} names a field twice")
        object.__setattr__(self, "_struct", struct.Struct(codes))
        object.__setattr__(self, "_offsets", offsets)

    def offset_of(self, name: str) -> int:
        """Return the offset of the field `name`, bytes."""
        return self._offsets[name]

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """Return the bytes of the structure. Fields missing from `values` get their defaults.

        Raises:
            EncodeError: the layout has no such field, or a value is outside its type.
        """
        unknown = values.keys() - self._offsets.keys()
        if unknown:
            raise EncodeError(f"{self.name} has no field {', '.join(sorted(unknown))}")
        flat: list[Any] = []
        for item in self.fields:
            value = values.get(item.name, item.default)
            if item.count == 1:
                flat.append(value)
            else:
                flat.extend(value if item.name in values else (item.default,) * item.count)
        try:
            return self._struct.pack(*flat)
        except (struct.error, OverflowError, TypeError) as error:
            raise EncodeError(f"{self.name}: {error}") from error

    def unpack(self, data: bytes | bytearray | memoryview, offset: int = 0) -> dict[str, Any]:
        """Return the fields of the structure at `offset`.

        Raises:
            ProtocolError: there are fewer bytes than the structure needs.
        """
        if offset < 0 or len(data) - offset < self.size:
            raise ProtocolError(f"{self.name} needs {self.size} bytes, {len(data) - offset} given")
        flat = iter(self._struct.unpack_from(data, offset))
        return {
            item.name: next(flat)
            if item.count == 1
            else tuple(next(flat) for _ in range(item.count))
            for item in self.fields
        }


TCP_PORT: Final = 52100
STATUS_PORT: Final = 52102

MAGIC: Final = 0x4F53
MAGIC_BYTES: Final = b"SO"


class MessageId(IntEnum):
    """Known message ids, from the documentation or from captures."""

    STATUS = 0x01
    FIRE = 0x15
    FULL_PING_RESULT = 0x22
    PING_RESULT = 0x23
    USER_CONFIG = 0x55
    LOG = 0x80
    DUMMY = 0xFF


class PingRate(IntEnum):
    """Ping rate of a fire message: an enumeration, not Hz. Its echo in results is undefined."""

    NORMAL = 0  # up to 10 Hz
    HIGH = 1  # 15 Hz
    HIGHEST = 2  # 40 Hz
    LOW = 3  # 5 Hz
    LOWEST = 4  # 2 Hz
    STANDBY = 5  # no transmission


class FireFlags(IntFlag):
    """Flags byte of a fire message."""

    RANGE_IN_METRES = 0x01
    SIXTEEN_BIT = 0x02
    SEND_GAIN = 0x04
    SIMPLE_RETURN = 0x08
    GAIN_ASSIST = 0x10  # sources disagree about the meaning of 1; interpreted as "on"
    LOW_POWER = 0x20
    FULL_BEAMS = 0x40  # 512 beams instead of 256
    NETWORK_TRIGGER = 0x80


EXTENDED_32_BIT: Final = 0x200
"""Extended flag of a version-2 fire message: 32-bit "scientific" samples."""

BYTES_PER_SAMPLE: Final = {0: 1, 1: 2, 2: 3, 3: 4}
"""Bytes per sample by the data-size field of a ping result."""

HEADER: Final = Layout(
    "header",
    16,
    (
        Field("magic", 0, U16, default=MAGIC),
        Field("source_id", 2, U16),
        Field("destination_id", 4, U16),
        Field("message_id", 6, U16),
        Field("version", 8, U16),
        Field("payload_size", 10, U32),
        Field("part_number", 14, U16),
    ),
)

FIRE_V1: Final = Layout(
    "fire v1",
    53,
    (
        *HEADER.fields,
        Field("mode", 16, U8),
        Field("ping_rate", 17, U8),
        Field("network_speed_mbps", 18, U8),
        Field("gamma", 19, U8),
        Field("flags", 20, U8),
        Field("range_demand", 21, F64, default=0.0),  # metres or percent, depending on the flags
        Field("gain_percent", 29, F64, default=0.0),
        Field("speed_of_sound_demand_mps", 37, F64, default=0.0),  # 0: the sonar computes it
        Field("salinity_ppt", 45, F64, default=0.0),
    ),
)

FIRE_V2: Final = Layout(
    "fire v2",
    89,
    (
        *FIRE_V1.fields,
        Field("extended_flags", 53, U32),
        Field("reserved_57", 57, "8s", default=b""),
        Field("beacon_frequency_hz", 65, U32),
        Field("reserved_69", 69, "20s", default=b""),
    ),
)

PING_RESULT_V1: Final = Layout(
    "ping result v1",
    122,
    (
        *FIRE_V1.fields,
        Field("ping_id", 53, U32),
        Field("status", 57, U32),
        Field("frequency_hz", 61, F64, default=0.0),
        Field("temperature_c", 69, F64, default=0.0),
        Field("pressure_bar", 77, F64, default=0.0),
        Field("speed_of_sound_mps", 85, F64, default=0.0),
        Field("start_ticks", 93, U32),
        Field("data_size", 97, U8),
        Field("range_resolution_m", 98, F64, default=0.0),
        Field("rows", 106, U16),
        Field("beams", 108, U16),
        Field("image_offset", 110, U32),
        Field("image_size", 114, U32),
        Field("message_size", 118, U32),
    ),
)

PING_RESULT_V2: Final = Layout(
    "ping result v2",
    202,
    (
        *FIRE_V2.fields,
        Field("ping_id", 89, U32),
        Field("status", 93, U32),
        Field("frequency_hz", 97, F64, default=0.0),
        Field("temperature_c", 105, F64, default=0.0),
        Field("pressure_bar", 113, F64, default=0.0),
        Field("heading_deg", 121, F64, default=0.0),
        Field("pitch_deg", 129, F64, default=0.0),
        Field("roll_deg", 137, F64, default=0.0),
        Field("speed_of_sound_mps", 145, F64, default=0.0),
        Field("start_time_s", 153, F64, default=0.0),
        Field("data_size", 161, U8),
        Field("range_resolution_m", 162, F64, default=0.0),
        Field("rows", 170, U16),
        Field("beams", 172, U16),
        Field("spare_174", 174, "16s", default=b""),
        Field("image_offset", 190, U32),
        Field("image_size", 194, U32),
        Field("message_size", 198, U32),
    ),
)

FULL_PING_RESULT: Final = Layout(
    "full ping result",
    588,
    (
        *HEADER.fields,
        Field("unnamed_16", 16, "9s", default=b""),
        Field("range_m", 25, F64, default=0.0),
        Field("unnamed_33", 33, "40s", default=b""),
        Field("beams", 73, U16),
        Field("unnamed_75", 75, "480s", default=b""),
        Field("rows", 555, U32),
        Field("unnamed_559", 559, "17s", default=b""),
        Field("image_offset", 576, U32),
        Field("image_size", 580, U32),
        Field("message_size", 584, U32),
    ),
)
"""The fields that the vendor's public header names; int16 bearings follow."""

STATUS: Final = Layout(
    "status",
    142,
    (
        *HEADER.fields,
        Field("device_id", 16, U32),
        Field("device_type", 20, U16),
        Field("device_part_number", 22, U16),
        Field("status_bits", 24, U32),
        Field("arm0_version", 28, U32),
        Field("arm0_date", 32, U32),
        Field("arm1_version", 36, U32),
        Field("arm1_date", 40, U32),
        Field("fpga_version", 44, U32),
        Field("fpga_date", 48, U32),
        Field("address", 52, "4s", default=b""),  # octets in dotted order
        Field("netmask", 56, "4s", default=b""),
        Field("client_address", 60, "4s", default=b""),
        Field("mac", 64, "6s", default=b""),
        Field("temperatures_c", 70, F64, count=8, default=0.0),
        Field("pressure_bar", 134, F64, default=0.0),
    ),
)

USER_CONFIG: Final = Layout(
    "user configuration",
    28,
    (
        *HEADER.fields,
        Field("address", 16, U32),  # 192.168.2.3 is the integer 0xC0A80203, unlike in STATUS
        Field("netmask", 20, U32),
        Field("dhcp", 24, U32),
    ),
)

DUMMY: Final = Layout("dummy", 16, HEADER.fields)

MIB: Final = 1 << 20

PAYLOAD_LIMITS: Final[Mapping[int, int]] = {
    MessageId.FIRE: 4096,
    MessageId.FULL_PING_RESULT: 16 * MIB,
    MessageId.PING_RESULT: 16 * MIB,
    MessageId.USER_CONFIG: 64,
    MessageId.LOG: 64 << 10,
    MessageId.DUMMY: 4096,
}
"""Largest accepted payload in bytes, by message id, in the TCP stream."""

UNKNOWN_PAYLOAD_LIMIT: Final = MIB
MAX_MESSAGE_SIZE: Final = HEADER.size + 16 * MIB
MIN_PING_PAYLOAD: Final = PING_RESULT_V1.size - HEADER.size + 2


def ping_result_layout(version: int) -> Layout | None:
    """Return the layout of a ping result with this header version, or None if it is unknown."""
    if version in (0, 1):  # some firmware writes 0 for version 1
        return PING_RESULT_V1
    return PING_RESULT_V2 if version == 2 else None  # noqa: PLR2004 - the version's own number
