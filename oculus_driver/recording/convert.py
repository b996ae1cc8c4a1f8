"""Converts recordings to other formats and reports what the target cannot represent."""

from __future__ import annotations

import os
import struct
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, Protocol

from oculus_driver.errors import RecordingError, RecordingUnwritableError
from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS, Chunk
from oculus_driver.recording.network_capture import SYN, TCP, UDP
from oculus_driver.recording.oculus_log import (
    FILE_HEADER,
    ITEM_HEADER,
    MESSAGE_ITEM,
    NS_PER_S,
    STAMP,
    STAMP_ITEM,
)
from oculus_driver.recording.recording import MCAP, OCULUS_LOG, OCULUS_RAW, PCAP, open_recording
from oculus_driver.recording.writer import RecordingWriter
from oculus_driver.stream import Message, StreamParser
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from oculus_driver.recording.chunk import Chunk
    from oculus_driver.recording.recording import Recording


WRITABLE: Final = (MCAP, OCULUS_LOG, OCULUS_RAW, PCAP)
"""Target formats of `convert`."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """Result of a conversion.

    Attributes:
        source_format, target_format: see `oculus_driver.recording.recording`.
        chunks: copied from the source.
        size_bytes: of the target file.
        left_out: bytes missing in the target, by reason: other_link (the format cannot represent
            the link), no_message (bytes outside messages), checksum (bytes that fail theirs).
        stamps_lost: chunks with a stamp, if the target has no stamps.
        damage: the first problem of the source, or None.
    """

    source_format: str
    target_format: str
    chunks: int
    size_bytes: int
    left_out: dict[str, int] = field(default_factory=dict)
    stamps_lost: int = 0
    damage: str | None = None


class _Sink(Protocol):
    def put(self, chunk: Chunk) -> None: ...

    def finish(self) -> None: ...


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    target_format: str = MCAP,
    *,
    overwrite: bool = False,
    allow_damaged: bool = False,
) -> Conversion:
    """Write the recording in `source` to `target`. The target appears once it is complete.

    MCAP represents everything. Other formats contain the data of sonars: pcap any number of sonars
    and their statuses; `.oculus` logs and raw streams the complete messages of the first sonar, raw
    streams without stamps.

    Args:
        source: any recording.
        target: file to write.
        target_format: one of `WRITABLE`.
        overwrite: replace an existing file.
        allow_damaged: write data that fail their checksum, too; they are then no longer marked.

    Raises:
        RecordingError: the source cannot be read, the target cannot be written, exists without
            `overwrite`, or is the source, or the format is not one of `WRITABLE`.
    """
    if target_format not in WRITABLE:
        raise RecordingError(f"cannot write {target_format!r}; choose {', '.join(WRITABLE)}")
    path = Path(target)
    with open_recording(source) as recording:
        _check(recording.path, path, overwrite=overwrite)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        left_out: Counter[str] = Counter()
        try:
            with _writing(part):
                good = recording if allow_damaged else _without_damaged(recording, left_out)
                chunks, stamped = _copy(recording, good, part, target_format, left_out)
                size = part.stat().st_size
                part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return Conversion(
            recording.format,
            target_format,
            chunks,
            size,
            dict(left_out),
            stamped if target_format == OCULUS_RAW else 0,
            recording.damage,
        )


def _check(source: Path, target: Path, *, overwrite: bool) -> None:
    if target.exists() and source.samefile(target):
        text = f"{target}: source and target are the same file; choose another name"
        raise RecordingUnwritableError(text)
    if target.is_dir():
        raise RecordingUnwritableError(f"{target}: path is a directory; name a file in it")
    if target.exists() and not overwrite:
        raise RecordingUnwritableError(f"{target}: file exists; choose another name")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        text = f"{path}: cannot be written: {reason}; check the disk"
        raise RecordingUnwritableError(text) from error


def _without_damaged(recording: Recording, left_out: Counter[str]) -> Iterator[Chunk]:
    """Yield the good chunks; a damaged one leaves a gap."""
    gaps: set[str] = set()
    for chunk in recording:
        if chunk.damaged:
            gaps.add(chunk.link)
            left_out["checksum"] += len(chunk.data)
        elif chunk.link in gaps:
            gaps.remove(chunk.link)
            yield replace(chunk, gap_before=True)
        else:
            yield chunk


def _copy(
    recording: Recording,
    chunks: Iterable[Chunk],
    path: Path,
    target_format: str,
    left_out: Counter[str],
) -> tuple[int, int]:
    """Write all chunks; return their number and the number of stamped ones."""
    if target_format == MCAP:
        metadata = recording.metadata | {"converted_from": recording.format}
        with RecordingWriter(path, metadata=metadata, overwrite=True) as writer:
            return _drain(chunks, _McapSink(writer))
    with path.open("wb") as file:
        return _drain(chunks, _SINKS[target_format](file, left_out))


def _drain(chunks: Iterable[Chunk], sink: _Sink) -> tuple[int, int]:
    count = stamped = 0
    for chunk in chunks:
        sink.put(chunk)
        count += 1
        stamped += chunk.arrival_ns is not None
    sink.finish()
    return count, stamped


class _McapSink:
    """Keeps links, stamps and gaps."""

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._links: dict[tuple[str, str], int] = {}

    def put(self, chunk: Chunk) -> None:
        key = chunk.link, chunk.encoding
        if key not in self._links:
            self._links[key] = self._writer.add_link(*key)
        gap = chunk.gap_before
        self._writer.write(self._links[key], chunk.data, chunk.arrival_ns, gap_before=gap)

    def finish(self) -> None:
        """Do nothing: no data are held back."""


_SONAR_ITEM_VERSION: Final = 0
_OTHER_ITEM_VERSION: Final = 2


class MessageFormat(Protocol):
    """A format of consecutive messages."""

    def write(self, file: BinaryIO, message: Message) -> None:
        """Append a message."""
        ...

    def finish(self, file: BinaryIO) -> None:
        """Write what a file without messages needs."""
        ...


class MessageSink:
    """Writes the messages of a recording's first sonar.

    Bytes outside messages and all other links are left out.

    Attributes:
        messages: written so far.
    """

    def __init__(self, file: BinaryIO, left_out: Counter[str], form: MessageFormat) -> None:
        self.messages = 0
        self._file = file
        self._left_out = left_out
        self._form = form
        self._parser = StreamParser(confirm=True)
        self._link: str | None = None

    def put(self, chunk: Chunk) -> None:
        """Write the messages that a chunk completes."""
        if chunk.encoding == OCULUS and self._link in (None, chunk.link):
            self._link = chunk.link
            gap = chunk.gap_before
            self._write(self._parser.feed(chunk.data, chunk.arrival_ns, gap_before=gap))
        else:
            self._left_out["other_link"] += len(chunk.data)

    def finish(self) -> None:
        """Write the last message."""
        self._write(self._parser.finish())
        self._form.finish(self._file)
        if self._parser.counters.bytes_rejected:
            self._left_out["no_message"] += self._parser.counters.bytes_rejected

    def _write(self, messages: list[Message]) -> None:
        for message in messages:
            self._form.write(self._file, message)
        self.messages += len(messages)


class RawFormat:
    """Consecutive messages without stamps."""

    def write(self, file: BinaryIO, message: Message) -> None:
        """Write the message's bytes."""
        file.write(message.data)

    def finish(self, file: BinaryIO) -> None:
        """Do nothing: an empty stream is an empty file."""


class LogFormat:
    """An `.oculus` log of version 1: items of the vendor, each followed by ENSTA's stamp item.

    The stamp items keep nanoseconds; readers that do not know them skip them by their size.
    """

    def __init__(self) -> None:
        self._begun = False

    def write(self, file: BinaryIO, message: Message) -> None:
        """Write the message and, if it has one, its stamp."""
        stamp_ns = message.arrival_ns or 0
        self._begin(file, stamp_ns)
        self._item(file, MESSAGE_ITEM, _SONAR_ITEM_VERSION, stamp_ns, message.data)
        if stamp_ns:
            seconds, rest_ns = divmod(stamp_ns, NS_PER_S)
            stamp = STAMP.pack({"s": seconds, "ns": rest_ns})
            self._item(file, STAMP_ITEM, _OTHER_ITEM_VERSION, stamp_ns, stamp)

    def finish(self, file: BinaryIO) -> None:
        """Write the header if there was no message."""
        self._begin(file, 0)

    def _begin(self, file: BinaryIO, stamp_ns: int) -> None:
        if not self._begun:
            self._begun = True
            created_s = round(stamp_ns / NS_PER_S, 3)
            file.write(FILE_HEADER.pack({"created_unix_s": created_s}))

    def _item(self, file: BinaryIO, kind: int, version: int, stamp_ns: int, payload: bytes) -> None:
        head = ITEM_HEADER.pack(
            {
                "kind": kind,
                "version": version,
                "unix_s": stamp_ns / NS_PER_S,
                "original_size": len(payload),
                "payload_size": len(payload),
            }
        )
        file.write(head + payload)


_FILE_HEAD: Final = struct.Struct("<IHHiIII")
_RECORD_HEAD: Final = struct.Struct("<IIII")
_MAGIC_NS: Final = 0xA1B23C4D
_RAW_IP: Final = 101
_SNAP_LENGTH: Final = 1 << 18
_SEGMENT: Final = 32 << 10
_MAX_DATAGRAM: Final = 65_507
_HOST: Final = bytes((198, 51, 100, 1))
_BROADCAST: Final = b"\xff\xff\xff\xff"
_CLIENT_PORT: Final = 40_000
_PUSH_ACK: Final = 0x18
_ACK: Final = 0x10
_WINDOW: Final = 0xFFFF
_MAX_SONARS: Final = 64
_NEXT_CONNECTION: Final = 1 << 28
_NS_PER_S: Final = 1_000_000_000
_LAST_NS: Final = (1 << 32) * _NS_PER_S - 1
"""The format stores seconds in 32 bits: until the year 2106."""


class PcapSink:
    """Writes sonars and statuses as a network capture; other links are left out.

    Nanosecond pcap of bare IPv4 packets. A gap in a stream, or its beginning, is a new connection.
    Addresses are from RFC 5737: 192.0.2.1 is the first sonar, 198.51.100.1 the host.
    """

    def __init__(self, file: BinaryIO, left_out: Counter[str]) -> None:
        self._file = file
        self._left_out = left_out
        self._sequences: dict[str, int] = {}
        self._numbers: dict[str, int] = {}
        self._last_ns = 0
        self._file.write(_FILE_HEAD.pack(_MAGIC_NS, 2, 4, 0, 0, _SNAP_LENGTH, _RAW_IP))

    def put(self, chunk: Chunk) -> None:
        """Write a chunk as packets; a chunk without a stamp gets the previous stamp."""
        if chunk.arrival_ns is not None:
            self._last_ns = min(chunk.arrival_ns, _LAST_NS)
        if chunk.encoding == OCULUS_STATUS and len(chunk.data) <= _MAX_DATAGRAM:
            self._status(chunk.data)
        elif chunk.encoding == OCULUS and self._number(chunk.link):
            self._stream(chunk)
        else:
            self._left_out["other_link"] += len(chunk.data)

    def finish(self) -> None:
        """Do nothing: packets are independent."""

    def _number(self, link: str) -> int:
        """Return the last octet of a sonar's address, 0 beyond the maximum number of sonars."""
        if link not in self._numbers and len(self._numbers) < _MAX_SONARS:
            self._numbers[link] = len(self._numbers) + 1
        return self._numbers.get(link, 0)

    def _status(self, datagram: bytes) -> None:
        head = struct.pack(">HHHH", STATUS_PORT, STATUS_PORT, 8 + len(datagram), 0)
        self._packet(UDP, head + datagram, _sonar(1), _BROADCAST)

    def _stream(self, chunk: Chunk) -> None:
        number = self._number(chunk.link)
        sequence = self._sequences.get(chunk.link)
        if sequence is None or chunk.gap_before:
            sequence = (sequence or 0) + _NEXT_CONNECTION
            self._segment(number, sequence, b"", SYN | _ACK)
            sequence += 1
        for start in range(0, len(chunk.data), _SEGMENT):
            part = chunk.data[start : start + _SEGMENT]
            self._segment(number, sequence + start, part, _PUSH_ACK)
        self._sequences[chunk.link] = sequence + len(chunk.data)

    def _segment(self, number: int, sequence: int, data: bytes, flags: int) -> None:
        ports = (TCP_PORT, _CLIENT_PORT + number)
        words = 5 << 4
        place = sequence & 0xFFFFFFFF
        head = struct.pack(">HHIIBBHHH", *ports, place, 1, words, flags, _WINDOW, 0, 0)
        self._packet(TCP, head + data, _sonar(number), _HOST)

    def _packet(self, protocol: int, body: bytes, source: bytes, destination: bytes) -> None:
        size = 20 + len(body)
        head = bytearray(
            struct.pack(
                ">BBHHHBBH4s4s", 0x45, 0, size, 0, 0x4000, 64, protocol, 0, source, destination
            )
        )
        struct.pack_into(">H", head, 10, _checksum(head))
        seconds, rest_ns = divmod(self._last_ns, _NS_PER_S)
        self._file.write(_RECORD_HEAD.pack(seconds, rest_ns, size, size) + head + body)


def _sonar(number: int) -> bytes:
    return bytes((192, 0, 2, number))


def _checksum(head: bytearray) -> int:
    """Return the checksum of an IP header (RFC 791)."""
    total = sum(int(word) for word in struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    return ~(total + (total >> 16)) & 0xFFFF


_SINKS: Final[dict[str, Callable[[BinaryIO, Counter[str]], _Sink]]] = {
    OCULUS_LOG: lambda file, left_out: MessageSink(file, left_out, LogFormat()),
    OCULUS_RAW: lambda file, left_out: MessageSink(file, left_out, RawFormat()),
    PCAP: PcapSink,
}
