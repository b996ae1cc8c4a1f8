"""Writes recordings that lose nothing in a crash of the program.

The file is MCAP. Each `write` goes to the operating system at once: it appends a message to the
open chunk and updates the chunk's head, with its checksum, in place. So a killed program leaves
every byte in the file, as a chunk that any MCAP reader accepts; a closed file is fully indexed.
Between the two steps the newest message stands behind the chunk, followed by a private record with
its checksum, which the next message overwrites. So every message of an unclosed file has a checksum
too, and data that a power cut damaged are detected. Chunks are not compressed: sonar images hardly
shrink (zstd saves a fifth), and compression would have to delay the writes.
"""

from __future__ import annotations

import os
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from oculus_driver.errors import RecordingError, RecordingUnwritableError
from oculus_driver.recording import mcap_records as mcap
from oculus_driver.recording.chunk import OCULUS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

FORMAT_VERSION: Final = 3
"""From 3 on every message has a checksum, also in files that were not closed."""

METADATA_NAME: Final = "oculus_driver.recording"
LIBRARY: Final = "oculus_driver"

GAP_STEP: Final = 1 << 16
"""Sequence numbers that a marked gap skips; damage skips fewer: a chunk has no room for so many."""

CHUNK_SIZE: Final = 1 << 12
"""Size at which a chunk ends. Each piece of a sonar's stream has a chunk of its own.

A damaged byte makes one chunk useless, and so does the end of a cut file: one ping at most.
"""

_MAX_LINKS: Final = 1 << 15
_U64_END: Final = 1 << 64


@dataclass(slots=True)
class _OpenChunk:
    """The chunk being written; its size counts record bytes."""

    offset: int
    size: int = 0
    crc: int = 0
    span_ns: tuple[int, int] | None = None
    indexes: dict[int, bytearray] = field(default_factory=dict)
    is_full: bool = False

    def head_with(self, stamp_ns: int, message: bytes) -> bytes:
        """Return the chunk's head as it is with one more message."""
        first, last = self.span_ns or (stamp_ns, stamp_ns)
        span_ns = (min(first, stamp_ns), max(last, stamp_ns))
        crc = zlib.crc32(message, self.crc)
        return mcap.chunk_head(*span_ns, self.size + len(message), crc)

    def add(self, number: int, stamp_ns: int, message: bytes) -> None:
        entry = mcap.U64.pack(stamp_ns) + mcap.U64.pack(self.size)
        self.indexes.setdefault(number, bytearray()).extend(entry)
        self.crc = zlib.crc32(message, self.crc)
        self.size += len(message)
        first, last = self.span_ns or (stamp_ns, stamp_ns)
        self.span_ns = (min(first, stamp_ns), max(last, stamp_ns))


class RecordingWriter:
    """An MCAP file of received bytes, one channel per link. Not thread-safe.

    Args:
        path: file to create.
        monotonic_to_unix_ns: added to every stamp; 0 if stamps are nanoseconds since 1970.
        metadata: free text about the recording, such as vehicle or site.
        overwrite: replace an existing file.

    Raises:
        RecordingError: the file cannot be created, or exists and `overwrite` is not set.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        monotonic_to_unix_ns: int = 0,
        metadata: Mapping[str, str] | None = None,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self._offset_ns = monotonic_to_unix_ns
        self._file = _create(self.path, overwrite=overwrite)
        self._position = 0
        self._channels: list[bytes] = []
        self._streams: set[int] = set()
        self._counts: Counter[int] = Counter()
        self._gaps: Counter[int] = Counter()
        self._span_ns: tuple[int, int] | None = None
        self._chunk: _OpenChunk | None = None
        self._chunk_indexes = bytearray()
        self._chunks = 0
        facts = {
            "format_version": str(FORMAT_VERSION),
            "monotonic_to_unix_ns": str(monotonic_to_unix_ns),
        }
        texts = dict(metadata or {}) | facts
        texts[mcap.CRC_KEY] = mcap.crc_of_texts(texts)
        note = mcap.metadata(METADATA_NAME, texts)
        try:
            self._append(mcap.MAGIC + mcap.header(LIBRARY))
            self._metadata_index = mcap.metadata_index(self._position, len(note), METADATA_NAME)
            self._append(note)
        except BaseException:  # disk full: leave no incomplete file
            with suppress(OSError):
                os.close(self._file)
            self.path.unlink(missing_ok=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def size_bytes(self) -> int:
        """Bytes in the file so far."""
        return self._position

    @property
    def messages(self) -> int:
        """Chunks written so far."""
        return self._counts.total()

    def add_link(self, name: str, encoding: str) -> int:
        """Declare a link and return its number for `write`."""
        number = len(self._channels) + 1
        if number > _MAX_LINKS:
            raise RecordingError(f"{self.path}: more than {_MAX_LINKS} links")
        note = mcap.channel(number, name, encoding)
        self._close_chunk()
        self._append(note)
        self._channels.append(note)
        self._counts[number] = 0
        if encoding == OCULUS:
            self._streams.add(number)
        return number

    def write(
        self,
        link: int,
        data: bytes | bytearray | memoryview,
        arrival_ns: int | None,
        *,
        gap_before: bool = False,
    ) -> None:
        """Record received bytes. They are with the operating system when this returns.

        Args:
            link: from `add_link`.
            data: any number of bytes.
            arrival_ns: arrival time; None if unknown.
            gap_before: bytes of this link are missing before these. The sequence number of the link
                skips `GAP_STEP` values, so that readers detect it. Ignored before the first bytes
                of a link.

        Raises:
            RecordingError: the disk is full or fails (the file stays as before this call), or
                `link` or `arrival_ns` is invalid.
        """
        stamp_ns = 0 if arrival_ns is None else arrival_ns + self._offset_ns
        if not 1 <= link <= len(self._channels) or not 0 <= stamp_ns < _U64_END:
            raise RecordingError(f"{self.path}: invalid link {link} or time {stamp_ns} ns")
        gaps = self._gaps[link] + (gap_before and self._counts[link] > 0)
        sequence = self._counts[link] + GAP_STEP * gaps
        message = mcap.message_head(link, sequence, stamp_ns, len(data)) + bytes(data)
        alone = link in self._streams
        if self._chunk is not None and (alone or self._chunk.is_full):
            self._close_chunk()
        chunk = self._chunk or self._open_chunk()
        start = self._position
        self._append(message, mcap.checksum(message))
        self._position = start + len(message)
        try:
            self._patch(chunk.head_with(stamp_ns, message), chunk.offset)
        except RecordingError:
            self._truncate(start)
            raise
        chunk.add(link, stamp_ns, message)
        chunk.is_full = alone or chunk.size >= CHUNK_SIZE
        self._counts[link] += 1
        self._gaps[link] = gaps

    def sync(self) -> None:
        """Flush everything to the disk; may take a while.

        The chunk ends here: a power failure may damage bytes that are written later, and the
        checksum of their chunk does not cover these.

        Raises:
            RecordingError: the disk is full or fails.
        """
        self._close_chunk()
        os.fdatasync(self._file)

    def close(self) -> None:
        """Write the index and close the file. May be called again."""
        if self._file < 0:
            return
        try:
            self._close_chunk()
            self._append(mcap.record(mcap.Opcode.DATA_END, mcap.U32.pack(0)))
            self._append(self._summary())
        finally:
            os.close(self._file)
            self._file = -1

    def _open_chunk(self) -> _OpenChunk:
        chunk = _OpenChunk(self._position)
        self._append(mcap.chunk_head(0, 0, 0, 0))
        self._chunk = chunk
        return chunk

    def _close_chunk(self) -> None:
        chunk = self._chunk
        if chunk is None:
            return
        self._chunk = None
        if chunk.span_ns is None:
            self._truncate(chunk.offset)
            return
        start = self._position
        places: dict[int, int] = {}
        notes = bytearray()
        for number, entries in chunk.indexes.items():
            places[number] = start + len(notes)
            notes += mcap.message_index(number, bytes(entries))
        place = (chunk.offset, start - chunk.offset)
        self._chunk_indexes += mcap.chunk_index(chunk.span_ns, place, places, len(notes))
        self._chunks += 1
        first, last = self._span_ns or chunk.span_ns
        self._span_ns = (min(first, chunk.span_ns[0]), max(last, chunk.span_ns[1]))
        self._append(bytes(notes))

    def _summary(self) -> bytes:
        groups = (
            (mcap.Opcode.CHANNEL, b"".join(self._channels)),
            (
                mcap.Opcode.STATISTICS,
                mcap.statistics(self._span_ns or (0, 0), self._counts, self._chunks),
            ),
            (mcap.Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (mcap.Opcode.METADATA_INDEX, self._metadata_index),
        )
        start = self._position
        body, offsets = bytearray(), bytearray()
        for opcode, notes in groups:
            if notes:
                offsets += mcap.summary_offset(opcode, start + len(body), len(notes))
                body += notes
        places = (start, start + len(body))
        footer = mcap.HEAD.pack(mcap.Opcode.FOOTER, mcap.FOOTER.size)
        footer += mcap.U64.pack(places[0]) + mcap.U64.pack(places[1])
        whole = bytes(body + offsets) + footer
        return whole + mcap.U32.pack(zlib.crc32(whole)) + mcap.MAGIC

    def _append(self, *parts: bytes) -> None:
        """Write at the end, all or nothing."""
        todo = b"".join(parts) if len(parts) != 1 else parts[0]
        start = self._position
        view = memoryview(todo)
        try:
            while view:
                written = os.pwrite(self._file, view, self._position)
                self._position += written
                view = view[written:]
        except OSError as error:
            self._truncate(start)
            raise self._failure(error) from error

    def _patch(self, data: bytes, offset: int) -> None:
        try:
            os.pwrite(self._file, data, offset)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> RecordingUnwritableError:
        reason = error.strerror or str(error)
        return RecordingUnwritableError(f"{self.path}: cannot write: {reason}; check the disk")

    def _truncate(self, size: int) -> None:
        os.ftruncate(self._file, size)
        self._position = size


def _create(path: Path, *, overwrite: bool) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | (os.O_TRUNC if overwrite else os.O_EXCL)
    try:
        return os.open(path, flags, 0o644)
    except FileExistsError as error:
        raise RecordingUnwritableError(f"{path}: file exists; choose another name") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise RecordingUnwritableError(
            f"{path}: cannot be created: {reason}; check folder and permissions"
        ) from error
