"""The packets of pcap files, of either byte order (draft-ietf-opsawg-pcap).

A record's head that makes no sense is damage: the next place is searched where two heads follow
each other that do, near in time to the last good one.
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

PCAP_MAGICS: Final = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order, and nanoseconds in one unit of the fraction, by the first four bytes."""

_FILE_HEAD: Final = 24
_LINK_TYPE_AT: Final = 20
_RECORD_HEAD: Final = 16
_NEAR_S: Final = 86_400

Head = tuple[int, int, int, int]


def read_pcap_packets(file: BinaryIO, size: int, progress: Progress) -> Iterator[Packet]:
    """Yield the packets of a pcap file of `size` bytes; fill in `progress`."""
    file.seek(0)
    head = file.read(_FILE_HEAD)
    progress.bytes_read = len(head)
    if len(head) < _FILE_HEAD:
        progress.cut("the file ends inside its header")
        return
    order, unit_ns = PCAP_MAGICS[head[:4]]
    (link_type,) = struct.unpack_from(order + "I", head, _LINK_TYPE_AT)
    # The upper half of the link type tells of checksums.
    yield from _Records(file, size, progress, order, unit_ns, link_type & 0xFFFF).read()


@dataclass(slots=True)
class _Records:
    file: BinaryIO
    size: int
    progress: Progress
    order: str
    unit_ns: int
    link_type: int
    head: struct.Struct = field(init=False)
    last_s: int | None = None

    def __post_init__(self) -> None:
        self.head = struct.Struct(self.order + "IIII")

    def read(self) -> Iterator[Packet]:
        """Yield all packets, from front to back."""
        at, before = _FILE_HEAD, _FILE_HEAD
        while raw := self.file.read(_RECORD_HEAD):
            if len(raw) < _RECORD_HEAD:
                self.progress.cut(f"ends inside a packet's head, at byte {self.size}")
                return
            head = self.head.unpack(raw)
            if not self._sound(head):
                found = self._search(before + 1)
                if found is None:
                    self.progress.cut(f"damaged at byte {at}: no packet here or behind")
                    return
                self.progress.report(f"damaged at byte {at}: no packet here")
                at = before = found
                self.file.seek(at)
                continue
            seconds, fraction, length, _ = head
            data = self.file.read(length)
            before, at = at, at + _RECORD_HEAD + len(data)
            self.last_s = seconds
            self.progress.bytes_read = at
            if len(data) < length:
                self.progress.cut(f"ends inside a packet, at byte {self.size}")
            stamp_ns = seconds * NS_PER_S + fraction * self.unit_ns
            yield Packet(stamp_ns or None, self.link_type, data)

    def _sound(self, head: Head) -> bool:
        _, fraction, length, original = head
        return length <= MAX_PACKET and length <= original and fraction * self.unit_ns < NS_PER_S

    def _search(self, start: int) -> int | None:
        """Return where the next two sound heads in a row begin, None if nowhere.

        Candidates share the upper half of the last good head's seconds.
        """
        if self.last_s is None:
            return None
        shift = 2 if self.order == "<" else 0
        high = struct.pack(self.order + "I", self.last_s)[shift : shift + 2]
        for place, window in windows(self.file, start, self.size, _RECORD_HEAD):
            found = window.find(high, shift)
            while found >= 0:
                if self._two_heads(place + found - shift):
                    return place + found - shift
                found = window.find(high, found + 1)
        return None

    def _two_heads(self, at: int) -> bool:
        for _ in range(2):
            if at == self.size:
                return True
            self.file.seek(at)
            raw = self.file.read(_RECORD_HEAD)
            if len(raw) < _RECORD_HEAD:
                return False
            head = self.head.unpack(raw)
            near = abs(head[0] - (self.last_s or 0)) <= _NEAR_S
            if not near or not self._sound(head):
                return False
            at += _RECORD_HEAD + head[2]
        return True
