"""Write what sonars sent as a network capture: each sonar at an address made for examples.

Nanosecond pcap of bare IPv4 packets. A gap in a stream, or its beginning, is a new connection.
Addresses are of RFC 5737: 192.0.2.1 is the first sonar, 198.51.100.1 the host.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS, Chunk
from oculus_driver.recording.packet_layers import SYN, TCP, UDP
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    from collections import Counter

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
"""The format counts seconds in 32 bits: until the year 2106."""


class PcapSink:
    """Takes the chunks of a recording; other links than sonars' and statuses are left out."""

    def __init__(self, file: BinaryIO, left_out: Counter[str]) -> None:
        self._file = file
        self._left_out = left_out
        self._sequences: dict[str, int] = {}
        self._numbers: dict[str, int] = {}
        self._last_ns = 0
        self._file.write(_FILE_HEAD.pack(_MAGIC_NS, 2, 4, 0, 0, _SNAP_LENGTH, _RAW_IP))

    def put(self, chunk: Chunk) -> None:
        """Write a chunk as packets; one without a stamp takes the one before it."""
        if chunk.arrival_ns is not None:
            self._last_ns = min(chunk.arrival_ns, _LAST_NS)
        if chunk.encoding == OCULUS_STATUS and len(chunk.data) <= _MAX_DATAGRAM:
            self._status(chunk.data)
        elif chunk.encoding == OCULUS and self._number(chunk.link):
            self._stream(chunk)
        else:
            self._left_out["other_link"] += len(chunk.data)

    def finish(self) -> None:
        """Nothing is left to write: each packet stands for itself."""

    def _number(self, link: str) -> int:
        """Return the last octet of a sonar's address, 0 beyond the number of sonars."""
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
