"""From a captured packet to what TCP or UDP carried: link, IP and transport headers.

Link types are those of the tcpdump.org list. Fragments of IP packets are not put together:
neither a sonar's stream nor its status needs them.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

TCP: Final = 6
UDP: Final = 17
SYN: Final = 0x02

_IPV4: Final = 0x0800
_IPV6: Final = 0x86DD
_VLANS: Final = (0x8100, 0x88A8, 0x9100)
_LINK_HEADERS: Final = {0: 4, 108: 4, 12: 0, 14: 0, 101: 0, 228: 0, 229: 0}
"""Bytes before the IP header, of links that say no protocol."""

_IPV4_HEAD: Final = struct.Struct(">BxHxxHxBxx4s4s")
_IPV6_HEAD: Final = struct.Struct(">4xHBx16s16s")
_TCP_HEAD: Final = struct.Struct(">HHI4xBB")
_UDP_HEAD: Final = struct.Struct(">HHH2x")
_U16: Final = struct.Struct(">H")
_TCP_LEAST: Final = 20
_ETHERNET: Final = 1
_COOKED: Final = 113
_COOKED_2: Final = 276
_VERSION_4: Final = 4
_VERSION_6: Final = 6
_FRAGMENT: Final = 0x3FFF
"""More fragments follow, or the offset is not 0."""


class Flow(NamedTuple):
    """One direction between two ends; addresses are packed, 4 or 16 bytes."""

    source: bytes
    source_port: int
    destination: bytes
    destination_port: int


class Segment(NamedTuple):
    """What one packet carried.

    Attributes:
        protocol: TCP or UDP.
        flow: from where to where.
        sequence: number of the first byte (TCP), else 0.
        flags: of TCP, else 0.
        payload: the bytes that were captured of it.
    """

    protocol: int
    flow: Flow
    sequence: int
    flags: int
    payload: bytes


def segment_of(link_type: int, data: bytes) -> Segment | None:
    """Return what a packet carried over TCP or UDP, None if it is anything else or too short."""
    try:
        at = _ip_offset(link_type, data)
        return None if at is None else _ip(data, at)
    except (struct.error, IndexError):  # the packet ends inside a header
        return None


def _ip_offset(link_type: int, data: bytes) -> int | None:
    """Return where the IP header starts, None if there is none."""
    known = _LINK_HEADERS.get(link_type)
    if known is not None:
        return known
    place = {_ETHERNET: (12, 14), _COOKED: (14, 16), _COOKED_2: (0, 20)}.get(link_type)
    if place is None:
        return None
    protocol_at, at = place
    (protocol,) = _U16.unpack_from(data, protocol_at)
    while protocol in _VLANS:
        (protocol,) = _U16.unpack_from(data, at + 2)
        at += 4
    return at if protocol in (_IPV4, _IPV6) else None


def _ip(data: bytes, at: int) -> Segment | None:
    version = data[at] >> 4
    if version == _VERSION_4:
        words, total, fragment, protocol, source, destination = _IPV4_HEAD.unpack_from(data, at)
        start = at + 4 * (words & 15)
        # Offloaded segments are captured with a total of 0: then all that is there counts.
        end = at + total if total else len(data)
        if fragment & _FRAGMENT:
            return None
    elif version == _VERSION_6:
        length, protocol, source, destination = _IPV6_HEAD.unpack_from(data, at)
        start = at + _IPV6_HEAD.size
        end = start + length if length else len(data)
    else:
        return None
    reader = _TRANSPORTS.get(protocol)
    return None if reader is None else reader(data, start, min(end, len(data)), source, destination)


def _tcp(data: bytes, start: int, end: int, source: bytes, destination: bytes) -> Segment | None:
    source_port, destination_port, sequence, words, flags = _TCP_HEAD.unpack_from(data, start)
    size = 4 * (words >> 4)
    if size < _TCP_LEAST:
        return None
    flow = Flow(source, source_port, destination, destination_port)
    return Segment(TCP, flow, sequence, flags, data[start + size : end])


def _udp(data: bytes, start: int, end: int, source: bytes, destination: bytes) -> Segment | None:
    source_port, destination_port, length = _UDP_HEAD.unpack_from(data, start)
    flow = Flow(source, source_port, destination, destination_port)
    end = min(end, start + length)
    return Segment(UDP, flow, 0, 0, data[start + _UDP_HEAD.size : end])


_TRANSPORTS: Final[dict[int, Callable[[bytes, int, int, bytes, bytes], Segment | None]]] = {
    TCP: _tcp,
    UDP: _udp,
}
