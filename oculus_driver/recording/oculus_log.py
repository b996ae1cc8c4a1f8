"""Reads Oculus Viewer logs (`.oculus`, version 1) of the vendor and of ENSTA's recorder.

Each item of type 10 contains one message, so chunks start and end with messages. At an invalid item
head the reader searches for the next valid one; the vendor's own reader stops there. The layouts
are little-endian and serve both directions; the padding of the vendor's structures is declared as
fields. Payloads may be compressed by Qt: the uncompressed size, 4 bytes big-endian, then a zlib
stream.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from oculus_driver.framing import Header, header_fault, read_header
from oculus_driver.recording.chunk import OCULUS, Chunk, Progress
from oculus_driver.recording.salvage import windows
from oculus_driver.wire import F64, HEADER, MAGIC_BYTES, MAX_MESSAGE_SIZE, U16, U32, Field, Layout

if TYPE_CHECKING:
    from collections.abc import Iterator


FILE_MAGIC: Final = 0x11223344
ITEM_MAGIC: Final = 0xAABBCCDD
CONVERTED_MAGIC: Final = 2037
"""Both magics of files written by a certain converter of ROS bags; their sizes are 0."""

FILE_HEADER: Final = Layout(
    "log header",
    48,
    (
        Field("magic", 0, U32, default=FILE_MAGIC),
        Field("header_size", 4, U32, default=48),
        Field("source", 8, "16s", default=b"Oculus"),
        Field("version", 24, U16, default=1),
        Field("encryption", 26, U16),
        Field("padding_28", 28, "4s", default=b""),
        Field("key", 32, "q"),
        Field("created_unix_s", 40, F64, default=0.0),
    ),
)

ITEM_HEADER: Final = Layout(
    "log item header",
    40,
    (
        Field("magic", 0, U32, default=ITEM_MAGIC),
        Field("header_size", 4, U32, default=40),
        Field("kind", 8, U16),
        Field("version", 10, U16),
        Field("padding_12", 12, "4s", default=b""),
        Field("unix_s", 16, F64, default=0.0),
        Field("compression", 24, U16),
        Field("padding_26", 26, "2s", default=b""),
        Field("original_size", 28, U32),
        Field("payload_size", 32, U32),
        Field("padding_36", 36, "4s", default=b""),
    ),
)

STAMP: Final = Layout("stamp", 16, (Field("s", 0, "Q"), Field("ns", 8, "Q")))
"""Payload of an ENSTA stamp item: arrival of the preceding message."""

MESSAGE_ITEM: Final = 10
"""Type of an item with one Oculus message, including the header."""

STAMP_ITEM: Final = 1010
"""Type of the item in which ENSTA's recorder stamps the preceding message."""

PLAIN: Final = 0
QT_COMPRESSED: Final = 1

NS_PER_S: Final = 1_000_000_000
_LATEST_NS: Final = 1 << 63


def stamp_ns(value: float, units_per_s: int = 1) -> int | None:
    """Return a time since 1970 in nanoseconds, None if it is not positive or too late.

    Seconds as 64-bit floats resolve about 0.2 µs today; integers are converted exactly.
    """
    if not math.isfinite(value) or not 0 < value < _LATEST_NS // NS_PER_S * units_per_s:
        return None
    whole = int(value)
    unit_ns = NS_PER_S // units_per_s
    return whole * unit_ns + round((value - whole) * unit_ns)


LINK: Final = "sonar"
_MAX_FILE_HEADER: Final = 4096


def is_encrypted(head: bytes) -> bool:
    """Return whether a log that starts with `head` is marked as encrypted."""
    return len(head) >= FILE_HEADER.size and FILE_HEADER.unpack(head)["encryption"] != 0


def read_oculus_log(file: BinaryIO, size: int, progress: Progress) -> Iterator[Chunk]:
    """Yield the messages of a log of `size` bytes in recorded order; update `progress`."""
    held: Chunk | None = None  # until the next item: a stamp may follow
    for item in _Items(file, size, progress).read():
        if item.kind == STAMP_ITEM:
            if held is not None:
                held = replace(held, arrival_ns=_stamp(item.data) or held.arrival_ns)
            continue
        if held is not None:
            progress.note_stamp(held.arrival_ns)
            yield held
        held = Chunk(LINK, OCULUS, item.arrival_ns, item.data, item.gap_before)
    if held is not None:
        progress.note_stamp(held.arrival_ns)
        yield held


@dataclass(frozen=True, slots=True)
class _Item:
    """A message or its stamp, decompressed; may be truncated."""

    kind: int
    arrival_ns: int | None
    data: bytes
    gap_before: bool


@dataclass(slots=True)
class _Items:
    file: BinaryIO
    size: int
    progress: Progress
    position: int = 0
    magic: int = ITEM_MAGIC
    gap: bool = False

    def read(self) -> Iterator[_Item]:
        """Yield the relevant items, from front to back."""
        self._open()
        while self.position < self.size:
            head = self._head()
            if head is None:
                if not self._search():
                    break
                continue
            item = self._item(head)
            self.progress.bytes_read = self.position
            if item is not None:
                yield item
        self.progress.bytes_read = self.size

    def _open(self) -> None:
        head = self._bytes(FILE_HEADER.size)
        if len(head) < FILE_HEADER.size:
            self.progress.report_truncation("the file ends inside its header")
            return
        fields = FILE_HEADER.unpack(head)
        if fields["magic"] == CONVERTED_MAGIC:
            self.magic = CONVERTED_MAGIC
        if FILE_HEADER.size < fields["header_size"] <= _MAX_FILE_HEADER:
            self._go(fields["header_size"])

    def _head(self) -> dict[str, Any] | None:
        """Return the item head with its true payload size, None if it is invalid."""
        data = self._bytes(ITEM_HEADER.size)
        if len(data) < ITEM_HEADER.size:
            return None
        fields = ITEM_HEADER.unpack(data)
        if fields["magic"] != self.magic or fields["header_size"] != ITEM_HEADER.size:
            return None
        if self.magic == CONVERTED_MAGIC:
            return self._converted(fields)
        return fields

    def _converted(self, fields: dict[str, Any]) -> dict[str, Any] | None:
        """Set the size of an item in a converted file from the message in it."""
        if fields["kind"] == STAMP_ITEM:
            return fields | {"payload_size": STAMP.size, "compression": PLAIN}
        data = self._bytes(HEADER.size)
        self._go(self.position - len(data))
        if len(data) < HEADER.size:
            return None
        header = read_header(data, 0)
        if not self._believable(header):
            return None
        return fields | {
            "kind": MESSAGE_ITEM,
            "payload_size": header.size,
            "compression": PLAIN,
        }

    def _believable(self, header: Header) -> bool:
        """Return whether a message starts here. An unknown id must be followed by an item."""
        if header_fault(header, strict=True) is None:
            return True
        start, end = self.position, self.position + header.size
        if header_fault(header, strict=False) is not None or end > self.size:
            return False
        self._go(end)
        follower = self._bytes(4)
        self._go(start)
        return not follower or follower == self.magic.to_bytes(4, "little")

    def _item(self, head: dict[str, Any]) -> _Item | None:
        """Return the item after `head`, None if it is irrelevant or unusable."""
        start, size = self.position, head["payload_size"]
        missing = start + size - self.size
        kind = head["kind"]
        if kind not in (MESSAGE_ITEM, STAMP_ITEM) or size > MAX_MESSAGE_SIZE:
            self._skip(head)
            return None
        if missing > 0 and self._find(start):
            self._lost(f"damaged at byte {start}: an item is longer than the file")
            return None
        if missing > 0:
            self.progress.report_truncation(f"ends inside an item, at byte {self.size}")
        data: bytes | None = self._bytes(size)
        if head["compression"] == QT_COMPRESSED and data is not None:
            data = uncompress(data)
        elif head["compression"] != PLAIN:
            data = None
        if data is None:
            self._lost(f"damaged at byte {start}: cannot decompress a message")
            return None
        gap, self.gap = self.gap and kind == MESSAGE_ITEM, self.gap and kind != MESSAGE_ITEM
        return _Item(kind, stamp_ns(head["unix_s"]), data, gap)

    def _skip(self, head: dict[str, Any]) -> None:
        start, size = self.position, head["payload_size"]
        if start + size > self.size:
            if self._find(start):
                self._lost(f"damaged at byte {start}: an item is longer than the file")
            else:
                self.progress.report_truncation(f"ends inside an item, at byte {self.size}")
                self._go(self.size)
            return
        self._go(start + size)
        if head["kind"] == MESSAGE_ITEM:
            self._lost(f"damaged at byte {start}: an item larger than any message")

    def _lost(self, text: str) -> None:
        self.gap = True
        self.progress.report(text)

    def _search(self) -> bool:
        """Go to the next item head; return False at the end."""
        start = self.position
        if self._find(max(0, start - ITEM_HEADER.size) + 1):
            self._lost(f"damaged at byte {start}: no valid item")
            return True
        self.progress.report_truncation(f"ends inside an item, at byte {self.size}")
        return False

    def _find(self, start: int) -> bool:
        """Go to the first plausible item head at or after `start`; stay without one."""
        wanted = ITEM_HEADER.pack({"magic": self.magic})[:8]
        for place, window in windows(self.file, start, self.size, ITEM_HEADER.size):
            at = window.find(wanted)
            while 0 <= at <= len(window) - ITEM_HEADER.size:
                if self._plausible(window, at, place):
                    self._go(place + at)
                    return True
                at = window.find(wanted, at + 1)
        return False

    def _plausible(self, window: bytes, at: int, start: int) -> bool:
        fields = ITEM_HEADER.unpack(window, at)
        room = self.size - start - at - ITEM_HEADER.size
        known = fields["compression"] in (PLAIN, QT_COMPRESSED)
        return bool(known and fields["payload_size"] <= room)

    def _bytes(self, size: int) -> bytes:
        self.file.seek(self.position)
        data = self.file.read(min(size, self.size - self.position))
        self.position += len(data)
        return data

    def _go(self, position: int) -> None:
        self.position = position


def _stamp(data: bytes) -> int | None:
    if len(data) < STAMP.size:
        return None
    fields = STAMP.unpack(data)
    value = int(fields["s"]) * NS_PER_S + int(fields["ns"])
    return value if 0 < value < 1 << 63 else None


_SIZE: Final = struct.Struct(">I")


def uncompress(data: bytes) -> bytes | None:
    """Return the decompressed data, None if they are damaged or larger than any message."""
    return inflate(data[_SIZE.size :])


def inflate(data: bytes) -> bytes | None:
    """Return the content of one complete zlib stream, None if it exceeds the largest message."""
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(data, MAX_MESSAGE_SIZE)
    except zlib.error:
        return None
    return content if stream.eof else None


def message_bytes(payload: bytes) -> bytes | None:
    """Return the Oculus message in a payload with either compression or none, else None."""
    if payload.startswith(MAGIC_BYTES):
        return payload
    for content in (inflate(payload), uncompress(payload)):
        if content is not None and content.startswith(MAGIC_BYTES):
            return content
    return None
