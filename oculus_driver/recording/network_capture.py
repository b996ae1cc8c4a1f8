"""Reads the streams and status broadcasts of sonars from network captures (pcap, pcapng).

A TCP flow is a sonar's if it comes from the sonar's port, or if its first bytes are the header of
a message that sonars send. Each sonar is a link: "sonar", "sonar-2" and so on by appearance; all
its connections follow each other in the link. Traffic to sonars is ignored.

A capture that ends inside a packet, or has damaged packets, is read as far as possible.

Link types are those of the tcpdump.org list. IP fragments are ignored: neither a sonar's stream
nor its status needs them.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple

from oculus_driver.errors import RecordingError
from oculus_driver.framing import header_fault, read_header
from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS, Chunk, Progress
from oculus_driver.recording.pcap_files import PCAPNG_MAGIC, read_pcap_packets, read_pcapng_packets
from oculus_driver.wire import HEADER, MAGIC, STATUS, STATUS_PORT, TCP_PORT, MessageId

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


MAX_HELD_BYTES: Final = 8 << 20
MAX_HELD_SEGMENTS: Final = 1 << 13
_WRAP: Final = 1 << 32
_NEAR: Final = 64 << 20
"""Maximum distance in bytes between segments of the same connection."""


class Piece(NamedTuple):
    """The next bytes of the stream.

    Attributes:
        arrival_ns: when the bytes became readable: never before the preceding bytes. Behind an
            abandoned gap, their own arrival: the receiver had the bytes missing in the capture.
        data: one or more bytes.
        lost: number of missing bytes before these.
        gap_before: bytes are missing before these; their number may be unknown.
    """

    arrival_ns: int | None
    data: bytes
    lost: int
    gap_before: bool


@dataclass(slots=True)
class TcpStream:
    """Reassembles one direction of a TCP connection: each byte once, from segments in any order.

    Of repeated bytes the first ones count. A gap is abandoned once 8 MiB or 8192 segments wait
    after it; the next piece reports it.
    """

    _next: int | None = None  # not wrapped
    _syn: int | None = None
    _held: list[tuple[int, bytes, int | None]] = field(default_factory=list)
    _held_bytes: int = 0
    _read_ns: int | None = None
    _lost: int = 0
    _gap: bool = False

    def feed(
        self, sequence: int, payload: bytes, arrival_ns: int | None, *, syn: bool = False
    ) -> list[Piece]:
        """Add one segment and return the bytes that it makes readable, in order.

        Args:
            sequence: number of its first byte, modulo 2³².
            payload: may be empty, truncated or repeated.
            arrival_ns: capture time.
            syn: a connection starts here; SYN counts as one byte.
        """
        pieces: list[Piece] = []
        start = self._unwrapped(sequence)
        if syn:
            if sequence != self._syn:
                pieces += self._restart(sequence + 1)
            self._syn = sequence
            start = self._unwrapped(sequence + 1)
        elif self._next is None or abs(start - self._next) > _NEAR:
            pieces += self._restart(sequence)
            start = sequence
        if payload:
            pieces += self._place(start, payload, arrival_ns)
        return pieces

    def flush(self) -> list[Piece]:
        """Abandon all gaps and return the bytes after them."""
        pieces: list[Piece] = []
        while self._held:
            pieces += self._jump()
        return pieces

    def _unwrapped(self, sequence: int) -> int:
        if self._next is None:
            return sequence
        return self._next + (sequence - self._next + _WRAP // 2) % _WRAP - _WRAP // 2

    def _restart(self, start: int) -> list[Piece]:
        pieces = self.flush()
        self._gap = self._next is not None
        self._next = start
        return pieces

    def _place(self, start: int, payload: bytes, arrival_ns: int | None) -> list[Piece]:
        if self._next is not None and start > self._next:
            self._hold(start, payload, arrival_ns)
            full = self._held_bytes > MAX_HELD_BYTES or len(self._held) > MAX_HELD_SEGMENTS
            return self._jump() if full else []
        return self._take(start, payload, arrival_ns) + self._drain()

    def _hold(self, start: int, payload: bytes, arrival_ns: int | None) -> None:
        at = bisect_left(self._held, start, key=lambda held: held[0])
        if at < len(self._held) and self._held[at][0] == start:
            if len(self._held[at][1]) >= len(payload):
                return
            self._held_bytes -= len(self._held.pop(at)[1])
        self._held.insert(at, (start, payload, arrival_ns))
        self._held_bytes += len(payload)

    def _jump(self) -> list[Piece]:
        """Continue after the first gap."""
        start = self._held[0][0]
        self._lost += start - (self._next or start)
        self._next = start
        self._gap = True
        return self._drain()

    def _drain(self) -> list[Piece]:
        pieces: list[Piece] = []
        while self._held and self._next is not None and self._held[0][0] <= self._next:
            start, payload, arrival_ns = self._held.pop(0)
            self._held_bytes -= len(payload)
            pieces += self._take(start, payload, arrival_ns)
        return pieces

    def _take(self, start: int, payload: bytes, arrival_ns: int | None) -> list[Piece]:
        """Return the new part of a segment that starts no later than the next byte."""
        known = (self._next or start) - start
        data = payload[known:] if known else payload
        if not data:
            return []
        self._next = start + len(payload)
        if arrival_ns is not None:
            self._read_ns = max(arrival_ns, self._read_ns or arrival_ns)
        piece = Piece(self._read_ns, data, self._lost, self._gap)
        self._lost, self._gap = 0, False
        return [piece]


LINK: Final = "sonar"
STATUS_LINK: Final = "status"
_MAX_FLOWS: Final = 256
_MAX_SONARS: Final = 64

Source = tuple[bytes, int]


def read_network_capture(file: BinaryIO, size: int, progress: Progress) -> Iterator[Chunk]:
    """Yield the data sent by sonars in a capture of `size` bytes, in order; update `progress`."""
    sorter = _FlowSorter(progress)
    for segment, arrival_ns in _segments(file, size, progress):
        yield from sorter.take(segment, arrival_ns)
    yield from sorter.finish()


class Datagram(NamedTuple):
    """A UDP datagram of a capture.

    Attributes:
        arrival_ns: capture time, nanoseconds since 1970; None if not recorded.
        port: destination port.
        payload: the captured bytes.
    """

    arrival_ns: int | None
    port: int
    payload: bytes


def read_datagrams(path: Path) -> Iterator[Datagram]:
    """Yield the datagrams of a capture, in order; damaged packets are skipped.

    Raises:
        RecordingError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            for segment, arrival_ns in _segments(file, size, Progress()):
                if segment.protocol == UDP:
                    yield Datagram(arrival_ns, segment.flow.destination_port, segment.payload)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error


def _segments(
    file: BinaryIO, size: int, progress: Progress
) -> Iterator[tuple[Segment, int | None]]:
    """Yield the TCP and UDP payloads of a capture, and their capture times."""
    file.seek(0)
    is_new = file.read(len(PCAPNG_MAGIC)) == PCAPNG_MAGIC
    read_packets = read_pcapng_packets if is_new else read_pcap_packets
    for packet in read_packets(file, size, progress):
        segment = segment_of(packet.link_type, packet.data)
        if segment is not None:
            yield segment, packet.arrival_ns


@dataclass(slots=True)
class _FlowSorter:
    """The flows of a capture. Too many flows close the one that was silent for the longest time."""

    progress: Progress
    flows: dict[Flow, TcpStream | None] = field(default_factory=dict)
    """The stream of each flow seen, None where it is not a sonar's."""
    links: dict[Source, str] = field(default_factory=dict)
    current: dict[Source, Flow] = field(default_factory=dict)

    def take(self, segment: Segment, arrival_ns: int | None) -> Iterator[Chunk]:
        """Yield the data completed by one segment."""
        if segment.protocol == UDP:
            if _is_status(segment):
                self.progress.note_stamp(arrival_ns)
                yield Chunk(STATUS_LINK, OCULUS_STATUS, arrival_ns, segment.payload)
            return
        flow = segment.flow
        syn = bool(segment.flags & SYN)
        known = flow in self.flows
        stream = self.flows.pop(flow, None)
        if stream is None and (syn or not known):
            if _may_be_sonar(segment):
                stream = TcpStream()
            elif not segment.payload:
                return  # the first payload decides
        self.flows[flow] = stream
        if stream is not None:
            pieces = stream.feed(segment.sequence, segment.payload, arrival_ns, syn=syn)
            yield from self._chunks(flow, pieces)
        if len(self.flows) > _MAX_FLOWS:
            yield from self._close(next(iter(self.flows)))

    def finish(self) -> Iterator[Chunk]:
        """Yield the data that still wait for missing segments."""
        for flow in list(self.flows):
            yield from self._close(flow)

    def _close(self, flow: Flow) -> Iterator[Chunk]:
        stream = self.flows.pop(flow)
        if stream is not None:
            yield from self._chunks(flow, stream.flush())

    def _chunks(self, flow: Flow, pieces: list[Piece]) -> Iterator[Chunk]:
        source = (flow.source, flow.source_port)
        for piece in pieces:
            link = self._link(source)
            if link is None:
                continue
            if piece.lost:
                self.progress.report(f"{piece.lost} bytes of link {link!r} were not captured")
            changed = self.current.get(source, flow) != flow
            self.current[source] = flow
            self.progress.note_stamp(piece.arrival_ns)
            gap = piece.gap_before or changed
            yield Chunk(link, OCULUS, piece.arrival_ns, piece.data, gap)

    def _link(self, source: Source) -> str | None:
        if source not in self.links:
            if len(self.links) == _MAX_SONARS:
                self.progress.report(f"more than {_MAX_SONARS} sonars; the others are ignored")
                return None
            self.links[source] = f"{LINK}-{len(self.links) + 1}" if self.links else LINK
        return self.links[source]


def _is_status(segment: Segment) -> bool:
    """Return whether a datagram is a sonar's status, by size, header and port."""
    if len(segment.payload) < STATUS.size:
        return False
    header = read_header(segment.payload, 0)
    ours = segment.flow.destination_port == STATUS_PORT or header.message_id == MessageId.STATUS
    return header.magic == MAGIC and ours


def _may_be_sonar(segment: Segment) -> bool:
    """Return whether a flow that starts with this segment is a sonar's."""
    if segment.flow.source_port == TCP_PORT:
        return True
    if len(segment.payload) < HEADER.size:
        return False
    header = read_header(segment.payload, 0)
    return header_fault(header, strict=True) is None and header.message_id != MessageId.FIRE


TCP: Final = 6
UDP: Final = 17
SYN: Final = 0x02

_IPV4: Final = 0x0800
_IPV6: Final = 0x86DD
_VLANS: Final = (0x8100, 0x88A8, 0x9100)
_LINK_HEADERS: Final = {0: 4, 108: 4, 12: 0, 14: 0, 101: 0, 228: 0, 229: 0}
"""Bytes before the IP header, for link types without a protocol field."""

_IPV4_HEAD: Final = struct.Struct(">BxHxxHxBxx4s4s")
_IPV6_HEAD: Final = struct.Struct(">4xHBx16s16s")
_TCP_HEAD: Final = struct.Struct(">HHI4xBB")
_UDP_HEAD: Final = struct.Struct(">HHH2x")
_U16: Final = struct.Struct(">H")
_MIN_TCP_HEADER: Final = 20
_ETHERNET: Final = 1
_COOKED: Final = 113
_COOKED_2: Final = 276
_VERSION_4: Final = 4
_VERSION_6: Final = 6
_FRAGMENT: Final = 0x3FFF
"""More fragments follow, or the offset is not 0."""


class Flow(NamedTuple):
    """One direction between two endpoints; addresses are packed, 4 or 16 bytes."""

    source: bytes
    source_port: int
    destination: bytes
    destination_port: int


class Segment(NamedTuple):
    """Payload of one packet.

    Attributes:
        protocol: TCP or UDP.
        flow: source and destination.
        sequence: number of the first byte (TCP), else 0.
        flags: of TCP, else 0.
        payload: the captured bytes.
    """

    protocol: int
    flow: Flow
    sequence: int
    flags: int
    payload: bytes


def segment_of(link_type: int, data: bytes) -> Segment | None:
    """Return the TCP or UDP payload of a packet, None for other or truncated packets."""
    try:
        at = _ip_offset(link_type, data)
        return None if at is None else _ip(data, at)
    except (struct.error, IndexError):  # truncated inside a header
        return None


def _ip_offset(link_type: int, data: bytes) -> int | None:
    """Return the offset of the IP header, None without one."""
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
        # Offloaded segments are captured with a total of 0: use all captured bytes.
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
    if size < _MIN_TCP_HEADER:
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
