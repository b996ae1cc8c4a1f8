"""The packets of pcapng files, of either byte order (draft-ietf-opsawg-pcapng).

Each block says its length twice. Where the two differ, the next packet block is searched whose
lengths agree.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.recording.captured_packet import MAX_PACKET, NS_PER_S, Packet
from oculus_driver.recording.windows import windows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oculus_driver.recording.chunk import Progress

PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"

_MAX_BLOCK: Final = MAX_PACKET + (1 << 16)
_MAX_INTERFACES: Final = 1 << 12
_LATEST_NS: Final = 1 << 63

_INTERFACE: Final = 1
_OLD_PACKET: Final = 2
_SIMPLE_PACKET: Final = 3
_PACKET: Final = 6
_OF_NO_INTEREST: Final = -1

_ORDERS: Final = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_FRAME: Final = 12
"""Kind and length before a block's body, length behind it."""

_PACKET_HEAD: Final = 20
_SIMPLE_HEAD: Final = 4
_INTERFACE_HEAD: Final = 8
_RESOLUTION: Final = 9
_OFFSET: Final = 14
_OFFSET_SIZE: Final = 8
_BINARY_RESOLUTION: Final = 0x80


def read_pcapng_packets(file: BinaryIO, size: int, progress: Progress) -> Iterator[Packet]:
    """Yield the packets of a pcapng file of `size` bytes; fill in `progress`."""
    return _Blocks(file, size, progress).read()


class _DamagedError(Exception):
    """No sound block stands here; carries what to tell a person."""


@dataclass(frozen=True, slots=True)
class _Interface:
    link_type: int
    snap_length: int
    units_per_s: int = 1_000_000
    offset_s: int = 0


@dataclass(slots=True)
class _Blocks:
    file: BinaryIO
    size: int
    progress: Progress
    order: str = "<"
    interfaces: list[_Interface] = field(default_factory=list)

    def read(self) -> Iterator[Packet]:
        """Yield the packets of all sections."""
        at = 0
        while at < self.size:
            self.file.seek(at)
            try:
                kind, body, length = self._block(at)
            except _DamagedError as damage:
                found = self._search(at + 1) if self.interfaces else None
                if found is None:
                    self.progress.cut(str(damage))
                    return
                self.progress.report(str(damage))
                at = found
                continue
            at += length
            self.progress.bytes_read = at
            if kind == _INTERFACE and len(self.interfaces) < _MAX_INTERFACES:
                self.interfaces.append(_interface(body, self.order))
            packet = self._packet(kind, body)
            if packet is not None:
                yield packet

    def _block(self, at: int) -> tuple[int, bytes, int]:
        """Return kind, body and whole length of the block here."""
        head = self.file.read(_FRAME)
        if len(head) < _FRAME:
            raise _DamagedError(f"ends inside a block, at byte {self.size}")
        if head[:4] == PCAPNG_MAGIC:
            self.order = _ORDERS.get(head[8:], self.order)
            self.interfaces.clear()
        kind, length = struct.unpack_from(self.order + "II", head)
        if length < _FRAME or length % 4:
            raise _DamagedError(f"damaged at byte {at}: a block that claims {length} bytes")
        if at + length > self.size:
            raise _DamagedError(f"ends inside a block, at byte {self.size}")
        if length > _MAX_BLOCK:
            return _OF_NO_INTEREST, b"", length
        rest = head[8:] + self.file.read(length - _FRAME)
        if rest[-4:] != struct.pack(self.order + "I", length):
            raise _DamagedError(f"damaged at byte {at}: a block's two lengths differ")
        return kind, rest[:-4], length

    def _search(self, start: int) -> int | None:
        """Return where the next packet block with agreeing lengths begins, None if nowhere."""
        kind = struct.pack(self.order + "I", _PACKET)
        for place, window in windows(self.file, start, self.size, _FRAME):
            found = window.find(kind)
            while 0 <= found <= len(window) - _FRAME:
                (length,) = struct.unpack_from(self.order + "I", window, found + 4)
                if self._agrees(place + found, length):
                    return place + found
                found = window.find(kind, found + 1)
        return None

    def _agrees(self, at: int, length: int) -> bool:
        least = _FRAME + _PACKET_HEAD
        if not least <= length <= _MAX_BLOCK or length % 4 or at + length > self.size:
            return False
        self.file.seek(at + length - 4)
        return self.file.read(4) == struct.pack(self.order + "I", length)

    def _packet(self, kind: int, body: bytes) -> Packet | None:
        if kind == _SIMPLE_PACKET and self.interfaces and len(body) >= _SIMPLE_HEAD:
            (length,) = struct.unpack_from(self.order + "I", body)
            interface = self.interfaces[0]
            length = min(length, interface.snap_length or length)
            return Packet(None, interface.link_type, body[_SIMPLE_HEAD : _SIMPLE_HEAD + length])
        if kind not in (_PACKET, _OLD_PACKET) or len(body) < _PACKET_HEAD:
            return None
        number_code = "I" if kind == _PACKET else "H2x"
        head = struct.unpack_from(self.order + number_code + "IIII", body)
        number, high, low, length, _ = head
        if number >= len(self.interfaces):
            self.progress.report(f"a packet of interface {number}, which was not declared")
            return None
        interface = self.interfaces[number]
        stamp_ns = (high << 32 | low) * NS_PER_S // interface.units_per_s
        stamp_ns += interface.offset_s * NS_PER_S
        known = stamp_ns if 0 < stamp_ns < _LATEST_NS else None
        return Packet(known, interface.link_type, body[_PACKET_HEAD : _PACKET_HEAD + length])


def _interface(body: bytes, order: str) -> _Interface:
    """Read an interface description and those of its options that concern time."""
    if len(body) < _INTERFACE_HEAD:
        return _Interface(-1, 0)
    link_type, snap_length = struct.unpack_from(order + "H2xI", body)
    units_per_s, offset_s, at = 1_000_000, 0, _INTERFACE_HEAD
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        value = body[at + 4 : at + 4 + length]
        if code == _RESOLUTION and len(value) == 1:
            units_per_s = _units_per_s(value[0])
        elif code == _OFFSET and len(value) == _OFFSET_SIZE:
            (offset_s,) = struct.unpack(order + "q", value)
        at += 4 + length + -length % 4
    return _Interface(link_type, snap_length, units_per_s, offset_s)


def _units_per_s(resolution: int) -> int:
    base = 2 if resolution & _BINARY_RESOLUTION else 10
    return int(base ** (resolution & ~_BINARY_RESOLUTION))
