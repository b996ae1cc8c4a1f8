"""Reads MCAP files from front to back, even truncated or damaged ones. The content never raises.

The index at the end is not needed. An uncompressed chunk is transparent: its head is skipped, and
its messages are read like messages of the file. So a truncated chunk yields everything up to the
cut. Compressed chunks are decompressed piece by piece. If a message itself is truncated, its
available bytes are yielded if the link is a byte stream. No claimed size allocates memory before
the bytes are read.

If bytes of a link are missing, its next chunk reports a gap. `RecordingWriter` numbers the messages
of a link, so damage elsewhere does not cause a gap and a completely missing chunk is detected. In
other files any damage is a gap in all links.

The checksum of a complete chunk is checked before its messages are yielded. If it fails, they are
yielded as damaged: nobody can know which of their bytes are wrong. In files that have a checksum
for each message (`format_version` 3), so are messages without one: a power cut leaves such.

Not the library `mcap`: it reads 1.3 times as fast, but raises at the first damage and yields
nothing of a truncated chunk; and the driver needs NumPy only.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, BinaryIO, Final, Protocol

from oculus_driver.recording import mcap_records as mcap
from oculus_driver.recording.chunk import OCULUS, Chunk, Progress
from oculus_driver.recording.mcap_records import Opcode, channel_of, read_summary
from oculus_driver.recording.salvage import MAX_RECORD, find_record
from oculus_driver.recording.writer import GAP_STEP, LIBRARY, METADATA_NAME

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator


_STREAMS: Final = frozenset({OCULUS})
"""Encodings of byte streams, in which a part of a chunk is useful, too."""

_NUMBERED: Final = "format_version"
"""Metadata key of `RecordingWriter`, which numbers the messages of each link without gaps."""

_CHECKED: Final = 3
"""Format version from which on every message has a checksum."""

_SEQUENCES: Final = 1 << 32
_SMALL_RECORD: Final = 1 << 20
_MAX_CHECKED: Final = 1 << 30
"""Larger chunks are not checked: reading them twice would take too long."""

_MAX_NAME: Final = 64
_PRIVATE: Final = 0x80
_LIKELY_LENGTH: Final = 1 << 40
_OPCODES: Final = frozenset(int(opcode) for opcode in Opcode if opcode < _PRIVATE)


class _DamagedRecordError(Exception):
    """The bytes here are not valid records; the message describes the damage."""


class _CutError(Exception):
    """The source ended inside a record.

    Attributes:
        resume: offset from which to search for records, None: directly after the damage.
    """

    def __init__(self, resume: int | None = None) -> None:
        super().__init__()
        self.resume = resume


def read_mcap(file: BinaryIO, size: int, progress: Progress) -> Iterator[Chunk]:
    """Yield the chunks of an MCAP file of `size` bytes in recorded order; update `progress`."""
    return iter(_Reader(file, size, progress))


@dataclass(slots=True)
class _Last:
    """The last message of a link.

    Attributes:
        sequence: expected number of its next message.
        losses: losses of the file at that time.
        broken: a part of the message is missing.
    """

    sequence: int
    losses: int
    broken: bool = False


@dataclass(slots=True)
class _Limited:
    """A part of a file, for a decompressor."""

    reader: _Reader
    left: int

    def read(self, size: int, /) -> bytes:
        data = self.reader.read(min(size, self.left))
        self.left -= len(data)
        return data


@dataclass(slots=True)
class _Reader:
    file: BinaryIO
    size: int
    progress: Progress
    position: int = 0
    channels: dict[int, tuple[str, str]] = field(default_factory=dict)
    last: dict[int, _Last] = field(default_factory=dict)
    losses: int = 0
    stamp_ns: int | None = None
    damaged_to: int = 0
    checked_to: int = 0
    is_checked: bool = False
    summary_read: bool = False
    finished: bool = False

    def read(self, size: int, /) -> bytes:
        """Return up to `size` bytes of the file, fewer only at its end."""
        data = self.file.read(min(size, self.size - self.position))
        self.position += len(data)
        self.progress.bytes_read = max(self.progress.bytes_read, self.position)
        return data

    def __iter__(self) -> Generator[Chunk]:
        if self.read(len(mcap.MAGIC)) != mcap.MAGIC:
            text = "the first bytes are damaged"
            if self._header_follows():
                self.progress.report(text)
            else:
                self._lose(1, text, text)
        while not self.finished:
            start = self.position
            try:
                yield from self._record()
            except _CutError as cut:
                end = f"ends inside a record, at byte {self.size}"
                self._lose(
                    start + 1 if cut.resume is None else cut.resume,
                    f"damaged at byte {start}: a record is longer than the file",
                    "the recording was not closed" if start == self.size else end,
                )
            except _DamagedRecordError as damage:
                text = f"damaged at byte {start}: {damage}"
                self._lose(start + 1, text, text)
        self.progress.bytes_read = self.size

    def _record(self) -> Generator[Chunk]:
        """Read one record of the file."""
        opcode, length = self._head(self)
        if opcode == Opcode.MESSAGE:
            yield from self._message(self, length)
        elif opcode == Opcode.CHUNK:
            yield from self._chunk(length)
        elif opcode == Opcode.FOOTER:
            self._footer(length)
        else:
            self._other(self, opcode, length)

    def _footer(self, length: int) -> None:
        if length != mcap.FOOTER.size:
            raise _DamagedRecordError(f"a footer of {length} bytes")
        _exactly(self, length)
        if _exactly(self, len(mcap.MAGIC)) != mcap.MAGIC:
            raise _DamagedRecordError("no end mark")
        self.finished = True

    def _head(self, source: ByteSource) -> tuple[int, int]:
        head = source.read(mcap.HEAD.size)
        if len(head) < mcap.HEAD.size:
            raise _CutError
        opcode, length = mcap.HEAD.unpack(head)
        if opcode not in _OPCODES and opcode < _PRIVATE:
            raise _DamagedRecordError(f"invalid record type {opcode:#04x}")
        return opcode, length

    def _message(self, source: ByteSource, length: int) -> Generator[Chunk]:
        if not mcap.MESSAGE_HEAD.size <= length <= MAX_RECORD:
            raise _DamagedRecordError(f"a message of {length} bytes")
        head = source.read(mcap.MESSAGE_HEAD.size)
        if len(head) < mcap.MESSAGE_HEAD.size:
            raise _CutError
        number, sequence, log_time_ns, _ = mcap.MESSAGE_HEAD.unpack(head)
        if not self._declared(number):
            raise _DamagedRecordError(f"a message of undeclared link {number}")
        self.stamp_ns = self.stamp_ns or log_time_ns or None
        start = self.position
        data, fault = self._content(source, length - mcap.MESSAGE_HEAD.size)
        damaged = start <= self.damaged_to
        if source is self and self.is_checked and start > max(self.damaged_to, self.checked_to):
            message = mcap.HEAD.pack(Opcode.MESSAGE, length) + head + data
            damaged = fault is not None or not self._has_checksum(message)
            if damaged:
                self.progress.report_damaged(start, len(data), "no checksum")
        link, encoding = self.channels[number]
        if fault is None or (data and encoding in _STREAMS):
            self.stamp_ns = log_time_ns or None
            self.progress.note_stamp(self.stamp_ns)
            gap = self._gap_before(number, sequence, broken=fault is not None)
            yield Chunk(link, encoding, self.stamp_ns, data, gap, damaged)
        if fault is not None:
            raise fault

    def _has_checksum(self, message: bytes) -> bool:
        """Return whether the next record is the checksum of a message."""
        expected = mcap.checksum(message)
        found = self.file.read(len(expected))
        self.file.seek(self.position)
        return found == expected

    def _gap_before(self, number: int, sequence: int, *, broken: bool) -> bool:
        """Return whether data of a link are missing before this message; remember the message."""
        last = self.last.get(number) or _Last(0 if self.losses else sequence, 0)
        self.last[number] = _Last(sequence + 1, self.losses, broken)
        lost = self.losses != last.losses
        if _NUMBERED not in self.progress.metadata:
            return lost or last.broken
        skipped = (sequence - last.sequence) % _SEQUENCES
        if skipped >= _SEQUENCES // 2:
            return last.broken  # the number went back
        missing = self._without_marks(skipped, lost=lost)
        if missing and not lost:
            link, _ = self.channels[number]
            self.progress.report(
                f"damaged before byte {self.position}: {missing} pieces of link {link!r} missing"
            )
        return skipped > 0 or last.broken

    def _without_marks(self, skipped: int, *, lost: bool) -> int:
        """Return how many of the skipped numbers are missing; count the gaps that are marked."""
        if self.progress.metadata[_NUMBERED] != "1":
            marked, missing = divmod(skipped, GAP_STEP)
        elif skipped == 1 and not lost:  # version 1 skips one number for a marked gap
            marked, missing = 1, 0
        else:
            marked, missing = 0, skipped
        self.progress.link_losses += marked
        return missing

    def _declared(self, number: int) -> bool:
        """Return whether a link is declared; if its record was lost, look in the summary."""
        if number not in self.channels and not self.summary_read:
            self.summary_read = True
            self.channels = read_summary(self.file, self.size).channels | self.channels
            self.file.seek(self.position)
        return number in self.channels

    def _content(
        self, source: ByteSource, size: int
    ) -> tuple[bytes, _CutError | _DamagedRecordError | None]:
        """Return the data of a message and, if they are incomplete, why.

        If no record follows a message, its length may be damaged. If a record starts inside the
        claimed length, the data end there.
        """
        start = self.position
        data = source.read(size)
        cut = len(data) < size
        if source is self and (cut or not self._record_follows()):
            found = self._next_record(start, self.position)
            if found is not None:
                return data[: found - start], _DamagedRecordError(f"a message of {size} bytes")
        return data, _CutError() if cut else None

    def _header_follows(self) -> bool:
        """Return whether the next bytes are the first record of a file of `RecordingWriter`."""
        first = mcap.header(LIBRARY)
        head = self.file.read(len(first))
        self.file.seek(self.position)
        return head == first

    def _record_follows(self) -> bool:
        """Return whether the next bytes can start a record; the end of the file counts as yes."""
        head = self.file.read(mcap.HEAD.size)
        self.file.seek(self.position)
        if len(head) < mcap.HEAD.size:
            return not head or head[0] in _OPCODES
        opcode, length = mcap.HEAD.unpack(head)
        if opcode < _PRIVATE:
            return opcode in _OPCODES and length < _LIKELY_LENGTH
        return bool(length <= self.size - self.position - mcap.HEAD.size)

    def _chunk(self, length: int) -> Generator[Chunk]:
        start = self.position
        head = _exactly(self, mcap.CHUNK_HEAD.size)
        _, _, inflated_size, crc, name_size = mcap.CHUNK_HEAD.unpack(head)
        if name_size > _MAX_NAME:
            raise _DamagedRecordError("an invalid chunk head")
        compression = _exactly(self, name_size).decode(errors="replace")
        (size,) = mcap.U64.unpack(_exactly(self, mcap.U64.size))
        if self.position - start + size != length:
            raise _DamagedRecordError("a chunk with contradicting sizes")
        self._check(compression, size, inflated_size, crc)
        if compression != "":
            yield from self._inflated(compression, size, inflated_size)

    def _check(self, compression: str, size: int, inflated_size: int, expected: int) -> None:
        """Compare the checksum of the next `size` bytes, a whole chunk; the position is kept.

        A checksum of 0 means that there is none. A chunk that is cut has none either, so what is
        left of it counts as damaged.
        """
        start = self.position
        if start + size > self.size and self.is_checked:
            self.damaged_to = self.size
            self.progress.report_truncation(f"ends inside a chunk, at byte {self.size}")
        if not expected or start + size > self.size or inflated_size > _MAX_CHECKED:
            return
        source: ByteSource = _Limited(self, size)
        if compression != "":
            source = ChunkDecompressor(compression, source)
        value, left = 0, size if compression == "" else inflated_size
        while left and (part := source.read(min(left, _SMALL_RECORD))):
            value = zlib.crc32(part, value)
            left -= len(part)
        self.position = start
        self.file.seek(start)
        fault = source.fault if isinstance(source, ChunkDecompressor) else None
        if left == inflated_size and fault is not None:
            return  # nothing of it can be read
        if left or value != expected:
            self.damaged_to = start + size
            self.progress.report_damaged(start, size, fault or "wrong checksum")
        else:
            self.checked_to = start + size

    def _inflated(self, compression: str, size: int, inflated_size: int) -> Generator[Chunk]:
        """Read the records of a compressed chunk, then skip to its end."""
        start = self.position
        compressed = _Limited(self, size)
        source = ChunkDecompressor(compression, compressed)
        try:
            while source.size < inflated_size:
                opcode, length = self._head(source)
                if opcode == Opcode.MESSAGE:
                    yield from self._message(source, length)
                else:
                    self._other(source, opcode, length)
        except _CutError:
            if source.fault is None and start + size <= self.size:
                source.fault = "premature end"
        except _DamagedRecordError as damage:
            source.fault = str(damage)
        if source.fault is not None and start + size <= self.size:
            self.losses += 1
            if start >= self.damaged_to:
                self.progress.report(f"damaged chunk at byte {start}: {source.fault}")
        if start + size > self.size:
            raise _CutError(self.size)  # compressed bytes could look like messages
        self._skip(start + size - self.position)

    def _other(self, source: ByteSource, opcode: int, length: int) -> None:
        """Read a record that is not a message."""
        if opcode in (Opcode.CHANNEL, Opcode.METADATA) and length <= _SMALL_RECORD:
            content = _exactly(source, length)
            if opcode == Opcode.CHANNEL:
                self._declare(content)
            else:
                self._note(content)
        elif source is self:
            self._pass_over(opcode, length)
        else:
            for left in range(length, 0, -_SMALL_RECORD):
                _exactly(source, min(left, _SMALL_RECORD))

    def _declare(self, content: bytes) -> None:
        channel = channel_of(content)
        if channel is None:
            raise _DamagedRecordError("a link without a name")
        self.channels[channel[0]] = channel[1:]

    def _note(self, content: bytes) -> None:
        name = next(iter(mcap.strings(content, 0)), "")
        if name != METADATA_NAME:
            return
        texts = iter(mcap.strings(content, 2 * mcap.U32.size + len(name.encode())))
        found = dict(zip(texts, texts, strict=False))
        crc = found.pop(mcap.CRC_KEY, None)
        if crc is not None and crc != mcap.crc_of_texts(found):
            raise _DamagedRecordError("metadata with a wrong checksum")
        self.progress.metadata = found
        version = found.get(_NUMBERED, "")
        self.is_checked = version.isdecimal() and int(version) >= _CHECKED

    def _pass_over(self, opcode: int, length: int) -> None:
        """Skip an unneeded record, unless it contains messages.

        Otherwise a changed opcode byte would hide a whole chunk. Attachments may contain anything.
        """
        end = self.position + length
        if opcode != Opcode.ATTACHMENT and end <= self.size:
            found = self._next_record(self.position, end)
            if found is not None:
                raise _DamagedRecordError(f"a record of type {opcode:#04x} with messages in it")
        self._skip(length)

    def _skip(self, length: int) -> None:
        if length > self.size - self.position:
            raise _CutError
        self.position += length
        self.file.seek(self.position)

    def _lose(self, start: int, damage: str, end: str) -> None:
        """Continue with the next record at or after `start` (`damage`), or stop (`end`)."""
        found = self._next_record(start, self.size)
        if found is None:
            if not self.progress.truncated:
                self.progress.report_truncation(end)
            self.finished = True
            return
        self.losses += 1
        self.progress.report(damage)
        self.position = found
        self.file.seek(found)

    def _next_record(self, start: int, stop: int) -> int | None:
        """Return the offset of the next record in between; the file position is kept."""
        found = find_record(self.file, (start, stop), self.size, self.channels, self.stamp_ns)
        self.file.seek(self.position)
        return found


def _exactly(source: ByteSource, size: int) -> bytes:
    data = source.read(size)
    if len(data) < size:
        raise _CutError
    return data


_PIECE: Final = 1 << 16
_MAX_WINDOW: Final = 1 << 26
"""Maximum memory of a zstd frame."""


class ByteSource(Protocol):
    """A sequential source of bytes."""

    def read(self, size: int, /) -> bytes:
        """Return up to `size` bytes, fewer only at the end."""
        ...


class ChunkDecompressor:
    """Decompresses one chunk. Ends early at damaged data and records the reason.

    Attributes:
        fault: what is wrong with the compressed data, or None.
        size: decompressed bytes so far.
    """

    def __init__(self, compression: str, source: ByteSource) -> None:
        self.fault: str | None = None
        self.size = 0
        try:
            self._some: Callable[[int], bytes] = _OPENERS[compression](source)
        except KeyError:
            self._fail(f"unknown compression {compression[:16]!r}")
        except ImportError as error:
            self._fail(f"compression {compression} needs the Python package {error.name}")

    def read(self, size: int, /) -> bytes:
        """Return `size` bytes, fewer only at the end or at damaged data."""
        parts: list[bytes] = []
        left = size
        while left and self.fault is None:
            try:
                part = self._some(min(left, _PIECE))
            except Exception as error:  # noqa: BLE001 - each decompressor raises its own exceptions
                self._fail(f"cannot decompress: {error}")
                break
            if not part:
                break
            parts.append(part)
            left -= len(part)
        self.size += size - left
        return b"".join(parts)

    def _fail(self, text: str) -> None:
        self.fault = text


def _open_zstd(source: ByteSource) -> Callable[[int], bytes]:
    decompressor = import_module("zstandard").ZstdDecompressor(max_window_size=_MAX_WINDOW)
    stream = decompressor.stream_reader(source, read_size=_PIECE, read_across_frames=True)

    def some(size: int) -> bytes:
        return bytes(stream.read(size))

    return some


def _open_lz4(source: ByteSource) -> Callable[[int], bytes]:
    decompressor = import_module("lz4.frame").LZ4FrameDecompressor()

    def some(size: int) -> bytes:
        part = b""
        while not part and not decompressor.eof:
            piece = source.read(_PIECE) if decompressor.needs_input else b""
            part = decompressor.decompress(piece, max_length=size)
            if not part and not piece:
                break
        return bytes(part)

    return some


_OPENERS: Final[dict[str, Callable[[ByteSource], Callable[[int], bytes]]]] = {
    "zstd": _open_zstd,
    "lz4": _open_lz4,
}
