"""Records of MCAP files, as far as recordings need them: opcodes, layouts, packing, summary.

An MCAP file consists of 8 magic bytes, records of opcode (u8), length (u64) and content, and the
magic again. All numbers are little-endian; strings and maps are preceded by a u32 length in bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, BinaryIO, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


MAGIC: Final = b"\x89MCAP0\r\n"


class Opcode(IntEnum):
    """Types of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F
    CHECKSUM = 0xC3
    """Private to `RecordingWriter`, which other readers skip: CRC-32 of the message before it."""


HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of the content."""

MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time; the data follow."""

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""First and last log time, uncompressed size and checksum, length of the compression's name.

The name, the u64 size of the records and the records follow.
"""

FOOTER: Final = struct.Struct("<QQI")
STATISTICS: Final = struct.Struct("<QHIIIIQQ")
"""Messages, schemas, channels, attachments, metadata, chunks, first and last log time."""

U16: Final = struct.Struct("<H")
U32: Final = struct.Struct("<I")
U64: Final = struct.Struct("<Q")


def record(opcode: Opcode, *content: bytes) -> bytes:
    """Return a record."""
    return b"".join((HEAD.pack(opcode, sum(map(len, content))), *content))


def string(text: str) -> bytes:
    """Return a string with its length."""
    data = text.encode()
    return U32.pack(len(data)) + data


def string_map(values: Mapping[str, str]) -> bytes:
    """Return a map of strings with its length."""
    data = b"".join(string(key) + string(value) for key, value in values.items())
    return U32.pack(len(data)) + data


CRC_KEY: Final = "crc32"
"""Key of a checksum over the other texts, in metadata and in the metadata of a channel."""


def crc_of_texts(texts: Mapping[str, str]) -> str:
    """Return the checksum of some texts, without the one under `CRC_KEY`."""
    others = {key: value for key, value in texts.items() if key != CRC_KEY}
    return f"{zlib.crc32(string_map(others)):08x}"


def checksum(message: bytes) -> bytes:
    """Return the record with the checksum of a message's record."""
    return record(Opcode.CHECKSUM, U32.pack(zlib.crc32(message)))


def header(library: str) -> bytes:
    """Return the first record of a file."""
    return record(Opcode.HEADER, string(""), string(library))


def channel(number: int, topic: str, encoding: str) -> bytes:
    """Return the record of a channel without a schema."""
    content = struct.pack("<HH", number, 0) + string(topic) + string(encoding)
    return record(Opcode.CHANNEL, content, string_map({CRC_KEY: f"{zlib.crc32(content):08x}"}))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return a metadata record."""
    return record(Opcode.METADATA, string(name), string_map(values))


def metadata_index(offset: int, length: int, name: str) -> bytes:
    """Return the index record of a metadata record."""
    return record(Opcode.METADATA_INDEX, struct.pack("<QQ", offset, length), string(name))


def message_head(number: int, sequence: int, log_time_ns: int, size: int) -> bytes:
    """Return the bytes before the `size` data bytes of a message, including the record head."""
    stamp = log_time_ns
    head = HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + size)
    return head + MESSAGE_HEAD.pack(number, sequence & 0xFFFFFFFF, stamp, stamp)


def chunk_head(first_ns: int, last_ns: int, size: int, crc: int) -> bytes:
    """Return the bytes before the `size` record bytes of an uncompressed chunk."""
    content = CHUNK_HEAD.size + U64.size
    return (
        HEAD.pack(Opcode.CHUNK, content + size)
        + CHUNK_HEAD.pack(first_ns, last_ns, size, crc, 0)
        + U64.pack(size)
    )


CHUNK_HEAD_SIZE: Final = len(chunk_head(0, 0, 0, 0))


def message_index(number: int, entries: bytes) -> bytes:
    """Return the index of one channel in the preceding chunk: u64 pairs of log time and offset."""
    return record(Opcode.MESSAGE_INDEX, U16.pack(number), U32.pack(len(entries)), entries)


def chunk_index(
    span_ns: tuple[int, int], place: tuple[int, int], indexes: Mapping[int, int], index_size: int
) -> bytes:
    """Return the index record of an uncompressed chunk at `place` (offset, length)."""
    offset, length = place
    size = length - CHUNK_HEAD_SIZE
    offsets = b"".join(struct.pack("<HQ", number, at) for number, at in indexes.items())
    return record(
        Opcode.CHUNK_INDEX,
        struct.pack("<QQQQ", *span_ns, offset, length),
        U32.pack(len(offsets)),
        offsets,
        U64.pack(index_size),
        string(""),
        struct.pack("<QQ", size, size),
    )


def statistics(span_ns: tuple[int, int], counts: Mapping[int, int], chunks: int) -> bytes:
    """Return the statistics of a file with one metadata record and no schemas."""
    per_channel = b"".join(struct.pack("<HQ", number, n) for number, n in counts.items())
    head = STATISTICS.pack(sum(counts.values()), 0, len(counts), 0, 1, chunks, *span_ns)
    return record(Opcode.STATISTICS, head, U32.pack(len(per_channel)), per_channel)


def summary_offset(opcode: Opcode, start: int, length: int) -> bytes:
    """Return the position of one type of records in the summary."""
    return record(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, length))


def strings(content: bytes, offset: int) -> Iterable[str]:
    """Yield consecutive strings from `offset`; stop at invalid data."""
    while offset + U32.size <= len(content):
        (size,) = U32.unpack_from(content, offset)
        offset += U32.size
        if offset + size > len(content):
            return
        yield content[offset : offset + size].decode(errors="replace")
        offset += size


_TAIL: Final = HEAD.size + FOOTER.size + len(MAGIC)
_MAX_RECORDS: Final = 1 << 16
"""Maximum number of summary records to read; the needed ones are near the beginning."""

_MAX_LENGTH: Final = 1 << 16


@dataclass(slots=True)
class Summary:
    """The needed part of a summary.

    Attributes:
        span_ns: earliest and latest log time, None if missing.
        channels: topic and encoding by number.
    """

    span_ns: tuple[int, int] | None = None
    channels: dict[int, tuple[str, str]] = field(default_factory=dict)


def channel_of(content: bytes) -> tuple[int, str, str] | None:
    """Return number, topic and encoding from a channel record's content, None if it is damaged."""
    texts = tuple(strings(content, 2 * U16.size))
    if len(texts) < 2:  # noqa: PLR2004 - topic and encoding
        return None
    (number,) = U16.unpack_from(content)
    size = 2 * U16.size + sum(U32.size + len(text.encode()) for text in texts[:2])
    notes = tuple(strings(content, size + U32.size))
    crc = dict(zip(notes[::2], notes[1::2], strict=False)).get(CRC_KEY)
    if crc is not None and crc != f"{zlib.crc32(content[:size]):08x}":
        return None
    return number, texts[0], texts[1]


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Return the summary, empty if the file has no valid one. Moves the file position."""
    summary = Summary()
    if size < _TAIL:
        return summary
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    if not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
        return summary
    position, _, _ = FOOTER.unpack_from(tail, HEAD.size)
    for _ in range(_MAX_RECORDS if position else 0):
        if position + HEAD.size > size - _TAIL:
            break
        file.seek(position)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        position += HEAD.size + length
        if opcode in (Opcode.CHANNEL, Opcode.STATISTICS) and length <= _MAX_LENGTH:
            _take(summary, opcode, file.read(length))
    return summary


def _take(summary: Summary, opcode: int, content: bytes) -> None:
    if opcode == Opcode.CHANNEL:
        channel = channel_of(content)
        if channel is not None:
            summary.channels[channel[0]] = channel[1:]
    elif len(content) >= STATISTICS.size:
        messages, *_, first_ns, last_ns = STATISTICS.unpack_from(content)
        if messages and first_ns:
            summary.span_ns = (first_ns, last_ns)
