"""Read network captures (pcap, pcapng): the streams and status broadcasts of sonars in them.

A TCP flow is a sonar's if it comes from the sonar's port, or if its first bytes are the header of
a message that sonars send. Each sonar is a link: "sonar", "sonar-2" and so on by appearance; all
connections to it follow each other in it. What hosts send to sonars is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.framing import header_fault, read_header
from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS, Chunk, Progress
from oculus_driver.recording.packet_layers import SYN, UDP, Flow, Segment, segment_of
from oculus_driver.recording.pcap_files import read_pcap_packets
from oculus_driver.recording.pcapng_packets import PCAPNG_MAGIC, read_pcapng_packets
from oculus_driver.recording.reassembly import Piece, TcpStream
from oculus_driver.wire import HEADER, MAGIC, STATUS, STATUS_PORT, TCP_PORT, MessageId

if TYPE_CHECKING:
    from collections.abc import Iterator

LINK: Final = "sonar"
STATUS_LINK: Final = "status"
_MAX_FLOWS: Final = 256
_MAX_SONARS: Final = 64

Source = tuple[bytes, int]


def read_network_capture(file: BinaryIO, size: int, progress: Progress) -> Iterator[Chunk]:
    """Yield what sonars sent in a capture of `size` bytes, in order; fill in `progress`."""
    file.seek(0)
    is_new = file.read(len(PCAPNG_MAGIC)) == PCAPNG_MAGIC
    read_packets = read_pcapng_packets if is_new else read_pcap_packets
    sorter = _Sorter(progress)
    for packet in read_packets(file, size, progress):
        segment = segment_of(packet.link_type, packet.data)
        if segment is not None:
            yield from sorter.take(segment, packet.arrival_ns)
    yield from sorter.finish()


@dataclass(slots=True)
class _Sorter:
    """Flows of a capture; the longest silent ones are let go when there are too many."""

    progress: Progress
    flows: dict[Flow, TcpStream | None] = field(default_factory=dict)
    """The stream of each flow seen, None where it is not a sonar's."""
    links: dict[Source, str] = field(default_factory=dict)
    current: dict[Source, Flow] = field(default_factory=dict)

    def take(self, segment: Segment, arrival_ns: int | None) -> Iterator[Chunk]:
        """Yield what one segment makes readable."""
        if segment.protocol == UDP:
            if _is_status(segment):
                self.progress.saw(arrival_ns)
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
                return  # the first bytes will tell
        self.flows[flow] = stream
        if stream is not None:
            pieces = stream.feed(segment.sequence, segment.payload, arrival_ns, syn=syn)
            yield from self._chunks(flow, pieces)
        if len(self.flows) > _MAX_FLOWS:
            yield from self._close(next(iter(self.flows)))

    def finish(self) -> Iterator[Chunk]:
        """Yield what still waits for missing segments."""
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
            self.progress.saw(piece.arrival_ns)
            gap = piece.gap_before or changed
            yield Chunk(link, OCULUS, piece.arrival_ns, piece.data, gap)

    def _link(self, source: Source) -> str | None:
        if source not in self.links:
            if len(self.links) == _MAX_SONARS:
                self.progress.report(f"more than {_MAX_SONARS} sonars; the others are left out")
                return None
            self.links[source] = f"{LINK}-{len(self.links) + 1}" if self.links else LINK
        return self.links[source]


def _is_status(segment: Segment) -> bool:
    """Tell whether a datagram is a sonar's status, by its size, its header or its port."""
    if len(segment.payload) < STATUS.size:
        return False
    header = read_header(segment.payload, 0)
    ours = segment.flow.destination_port == STATUS_PORT or header.message_id == MessageId.STATUS
    return header.magic == MAGIC and ours


def _may_be_sonar(segment: Segment) -> bool:
    """Tell whether a flow that begins with this segment is a sonar's."""
    if segment.flow.source_port == TCP_PORT:
        return True
    if len(segment.payload) < HEADER.size:
        return False
    header = read_header(segment.payload, 0)
    return header_fault(header, strict=True) is None and header.message_id != MessageId.FIRE
