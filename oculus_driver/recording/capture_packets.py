"""The packets of network captures: pcap and pcapng files, of either byte order.

Formats: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. No claimed length is believed beyond
the largest packet; a file whose lengths make no sense is read up to there.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oculus_driver.recording.chunk import Progress

PCAP_MAGICS: Final = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order, and nanoseconds in one unit of the fraction, by the first four bytes."""

PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"

MAX_PACKET: Final = 1 << 20
_MAX_BLOCK: Final = MAX_PACKET + (1 << 16)
_MAX_INTERFACES: Final = 1 << 12
_LATEST_NS: Final = 1 << 63
_NS_PER_S: Final = 1_000_000_000

_SECTION: Final = 0x0A0D0D0A
_INTERFACE: Final = 1
_OLD_PACKET: Final = 2
_SIMPLE_PACKET: Final = 3
_PACKET: Final = 6
_ORDERS: Final = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_RESOLUTION: Final = 9
_OFFSET: Final = 14
_BINARY_RESOLUTION: Final = 0x80
_BLOCK_FRAME: Final = 12


class Packet(NamedTuple):
    """One captured packet.

    Attributes:
        arrival_ns: when it was captured, nanoseconds since 1970; None where not recorded.
        link_type: how its first header is to be read, a number of the tcpdump.org list.
        data: its bytes, perhaps not all.
    """

    arrival_ns: int | None
    link_type: int
    data: bytes


def read_packets(file: BinaryIO, size: int, progress: Progress) -> Iterator[Packet]:
    """Yield the packets of a pcap or pcapng file of `size` bytes; fill in `progress`."""
    file.seek(0)
    magic = file.read(4)
    file.seek(0)
    order = PCAP_MAGICS.get(magic)
    if order is None:
        return _Blocks(file, size, progress).read()
    return _read_pcap(file, progress, *order)


def _read_pcap(file: BinaryIO, progress: Progress, order: str, unit_ns: int) -> Iterator[Packet]:
    header, record = struct.Struct(order + "20xI"), struct.Struct(order + "IIII")
    head = file.read(header.size)
    progress.bytes_read = len(head)
    if len(head) < header.size:
        progress.cut("the file ends inside its header")
        return
    link_type = header.unpack(head)[0] & 0xFFFF  # the upper half tells of checksums
    while head := file.read(record.size):
        start = progress.bytes_read
        if len(head) < record.size:
            progress.cut(f"ends inside a packet's head, at byte {start + len(head)}")
            return
        seconds, fraction, length, _ = record.unpack(head)
        if length > MAX_PACKET:
            progress.cut(f"damaged at byte {start}: a packet that claims {length} bytes")
            return
        data = file.read(length)
        progress.bytes_read = start + len(head) + len(data)
        if len(data) < length:
            progress.cut(f"ends inside a packet, at byte {progress.bytes_read}")
        yield Packet(seconds * _NS_PER_S + fraction * unit_ns or None, link_type, data)


@dataclass(frozen=True, slots=True)
class _Interface:
    link_type: int
    snap_length: int
    units_per_s: int = 1_000_000
    offset_s: int = 0


@dataclass(slots=True)
class _Blocks:
    """The blocks of a pcapng file."""

    file: BinaryIO
    size: int
    progress: Progress
    order: str = "<"
    interfaces: list[_Interface] = field(default_factory=list)

    def read(self) -> Iterator[Packet]:
        """Yield the packets of all sections."""
        position = 0
        while position < self.size:
            block = self._block(position)
            if block is None:
                return
            kind, body, length = block
            position += length
            self.progress.bytes_read = position
            if kind == _INTERFACE and len(self.interfaces) < _MAX_INTERFACES:
                self.interfaces.append(_interface(body, self.order))
            else:
                packet = self._packet(kind, body)
                if packet is not None:
                    yield packet

    def _block(self, position: int) -> tuple[int, bytes, int] | None:
        """Return kind, body and whole length of the block here, None where nothing sound is."""
        head = self.file.read(_BLOCK_FRAME)
        if len(head) < _BLOCK_FRAME:
            return self._stop(f"ends inside a block, at byte {self.size}")
        if head[:4] == PCAPNG_MAGIC:
            self.order = _ORDERS.get(head[8:], self.order)
            self.interfaces.clear()
        kind, length = struct.unpack_from(self.order + "II", head)
        if length < _BLOCK_FRAME or length % 4:
            return self._stop(f"damaged at byte {position}: a block that claims {length} bytes")
        if position + length > self.size:
            return self._stop(f"ends inside a block, at byte {self.size}")
        if length > _MAX_BLOCK:  # of no kind that matters here
            self.file.seek(position + length)
            return -1, b"", length
        rest = head[8:] + self.file.read(length - _BLOCK_FRAME)
        if rest[-4:] != struct.pack(self.order + "I", length):
            return self._stop(f"damaged at byte {position}: a block's two lengths differ")
        return kind, rest[:-4], length

    def _stop(self, text: str) -> tuple[int, bytes, int] | None:
        self.progress.cut(text)
        return None

    def _packet(self, kind: int, body: bytes) -> Packet | None:
        if kind == _SIMPLE_PACKET and self.interfaces and len(body) >= 4:  # noqa: PLR2004 - one word
            (length,) = struct.unpack_from(self.order + "I", body)
            interface = self.interfaces[0]
            data = body[4 : 4 + min(length, interface.snap_length or length)]
            return Packet(None, interface.link_type, data)
        if kind not in (_PACKET, _OLD_PACKET) or len(body) < 20:  # noqa: PLR2004 - five words
            return None
        head = "I" if kind == _PACKET else "H2x"
        number, high, low, length, _ = struct.unpack_from(self.order + head + "IIII", body)
        if number >= len(self.interfaces):
            self.progress.report(f"a packet of interface {number}, which was not declared")
            return None
        interface = self.interfaces[number]
        stamp_ns = (high << 32 | low) * _NS_PER_S // interface.units_per_s
        stamp_ns += interface.offset_s * _NS_PER_S
        known = stamp_ns if 0 < stamp_ns < _LATEST_NS else None
        return Packet(known, interface.link_type, body[20 : 20 + length])


def _base(resolution: int) -> int:
    return 2 if resolution & _BINARY_RESOLUTION else 10


def _interface(body: bytes, order: str) -> _Interface:
    """Read an interface description and those of its options that concern time."""
    if len(body) < 8:  # noqa: PLR2004 - its fixed part
        return _Interface(-1, 0)
    link_type, snap_length = struct.unpack_from(order + "H2xI", body)
    units_per_s, offset_s, at = 1_000_000, 0, 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        value = body[at + 4 : at + 4 + length]
        if code == _RESOLUTION and len(value) == 1:
            power = value[0] & ~_BINARY_RESOLUTION
            units_per_s = _base(value[0]) ** power
        elif code == _OFFSET and len(value) == 8:  # noqa: PLR2004 - its only size
            (offset_s,) = struct.unpack(order + "q", value)
        at += 4 + length + -length % 4
    return _Interface(link_type, snap_length, units_per_s, offset_s)
