"""Content of a recording, counted with the rules of the live driver."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from oculus_driver.full_ping import FullPing, decode_full_ping
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.recording.chunk import OCULUS, OCULUS_STATUS, Chunk
from oculus_driver.status import Status, decode_status
from oculus_driver.stream import Message, StreamParser
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    from oculus_driver.recording.recording import Recording

MAX_LISTED_PINGS: Final = 1_000_000
_MAX_LINKS: Final = 1024
_MAX_STREAMS: Final = 64


@dataclass(frozen=True, slots=True)
class PingInfo:
    """One ping of a recording.

    Attributes:
        id: ping id.
        link: of the recording.
        offset: of its message in the bytes of the link.
        arrival_ns: nanoseconds since 1970, None if not recorded.
        rows, beams, bits_per_sample: of its image.
        range_m: far end of the image.
        frequency_hz: None if it is not a positive number.
    """

    id: int
    link: str
    offset: int
    arrival_ns: int | None
    rows: int
    beams: int
    bits_per_sample: int
    range_m: float
    frequency_hz: float | None


@dataclass(slots=True)
class LinkInfo:
    """One link of a recording: encoding, number of chunks and bytes."""

    encoding: str
    chunks: int = 0
    bytes: int = 0


@dataclass(slots=True)
class RecordingInfo:
    """Content of a recording.

    Attributes:
        format: see `oculus_driver.recording.recording`.
        size_bytes: of the file.
        truncated, damage, faults, damaged_bytes, link_losses: see `Recording`.
        start_ns, end_ns: earliest and latest stamp, None without stamps.
        metadata: of the recording.
        links: by name.
        messages: complete messages of all sonars.
        messages_by_id: the same by message id.
        pings: valid pings.
        full_pings: valid full ping results, which nothing maps.
        bytes_total: of the sonars' streams.
        bytes_rejected: bytes among these outside messages.
        rejects: rejected messages and pings by reason: reasons of
            `oculus_driver.stream.StreamCounters` and `oculus_driver.errors.Reject`, and
            too_many_links (a chunk of a 65th sonar).
        warnings: warnings of accepted messages and pings.
        resyncs: how often synchronisation was lost.
        lost_pings, duplicates, restarts: by the ping ids.
        statuses: valid status datagrams; invalid ones are rejects.
        ping_list: the first million pings, in order; `pings` counts all.
    """

    format: str
    size_bytes: int
    truncated: bool = False
    damage: str | None = None
    faults: int = 0
    damaged_bytes: int = 0
    link_losses: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    links: dict[str, LinkInfo] = field(default_factory=dict)
    messages: int = 0
    messages_by_id: Counter[int] = field(default_factory=Counter)
    pings: int = 0
    full_pings: int = 0
    bytes_total: int = 0
    bytes_rejected: int = 0
    rejects: Counter[str] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)
    resyncs: int = 0
    lost_pings: int = 0
    duplicates: int = 0
    restarts: int = 0
    statuses: int = 0
    ping_list: list[PingInfo] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return it for `json`: without NaN, all keys strings."""
        return {item.name: _plain(getattr(self, item.name)) for item in fields(self)}


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever the fields hold
    if isinstance(value, Counter):
        return {str(key): value[key] for key in sorted(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [asdict(item) for item in value]
    return asdict(value) if isinstance(value, LinkInfo) else value


@dataclass(slots=True)
class _SonarStream:
    """State of reading one sonar's stream."""

    parser: StreamParser = field(default_factory=lambda: StreamParser(confirm=True))
    sequence: PingSequence = field(default_factory=PingSequence)


def describe(recording: Recording) -> RecordingInfo:
    """Read a recording from front to back and return its content.

    At most a million pings are listed, which takes about 200 MB; everything else is small.
    """
    info = RecordingInfo(recording.format, recording.size_bytes)
    streams: dict[str, _SonarStream] = {}
    for chunk in recording:
        _count(info, chunk)
        if chunk.encoding == OCULUS_STATUS:
            _take_status(info, chunk.data)
        elif chunk.encoding == OCULUS:
            stream = _stream(streams, chunk.link)
            if stream is None:
                info.rejects["too_many_links"] += 1
                continue
            for message in stream.parser.feed(
                chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before
            ):
                _take(info, chunk.link, stream, message)
    for link, stream in streams.items():
        for message in stream.parser.finish():
            _take(info, link, stream, message)
        _add_up(info, stream)
    info.truncated, info.damage, info.faults = (
        recording.truncated,
        recording.damage,
        recording.faults,
    )
    info.damaged_bytes, info.link_losses = recording.damaged_bytes, recording.link_losses
    info.start_ns, info.end_ns = recording.start_ns, recording.end_ns
    info.metadata = recording.metadata
    return info


def _stream(streams: dict[str, _SonarStream], link: str) -> _SonarStream | None:
    """Return the stream of a link, None beyond the maximum number of streams."""
    if link not in streams and len(streams) < _MAX_STREAMS:
        streams[link] = _SonarStream()
    return streams.get(link)


def _count(info: RecordingInfo, chunk: Chunk) -> None:
    link = info.links.get(chunk.link)
    if link is None and len(info.links) < _MAX_LINKS:
        link = info.links[chunk.link] = LinkInfo(chunk.encoding)
    if link is not None:
        link.chunks += 1
        link.bytes += len(chunk.data)


def _take(info: RecordingInfo, link: str, stream: _SonarStream, message: Message) -> None:
    if message.message_id == MessageId.FULL_PING_RESULT:
        full = decode_full_ping(message)
        if isinstance(full, FullPing):
            info.full_pings += 1
        else:
            info.rejects[full.reason] += 1
    if message.message_id != MessageId.PING_RESULT:
        return
    ping = decode_ping(message)
    if not isinstance(ping, Ping):
        info.rejects[ping.reason] += 1
        if ping.ping_id is not None:
            stream.sequence.accept(ping.ping_id)
        return
    stream.sequence.accept(ping.ping_id)
    info.pings += 1
    info.warnings.update(ping.warnings)
    if len(info.ping_list) < MAX_LISTED_PINGS:
        info.ping_list.append(_ping_info(ping, link))


def _ping_info(ping: Ping, link: str) -> PingInfo:
    return PingInfo(
        id=ping.ping_id,
        link=link,
        offset=ping.offset,
        arrival_ns=ping.arrival_ns,
        rows=ping.rows,
        beams=ping.beams,
        bits_per_sample=ping.bits_per_sample,
        range_m=ping.max_range_m,
        frequency_hz=None if math.isnan(ping.frequency_hz) else ping.frequency_hz,
    )


def _take_status(info: RecordingInfo, data: bytes) -> None:
    status = decode_status(data)
    if isinstance(status, Status):
        info.statuses += 1
    else:
        info.rejects[status.reason] += 1


def _add_up(info: RecordingInfo, stream: _SonarStream) -> None:
    counters, sequence = stream.parser.counters, stream.sequence
    info.messages += counters.messages.total()
    info.messages_by_id += counters.messages
    info.bytes_total += counters.bytes_total
    info.bytes_rejected += counters.bytes_rejected
    info.rejects += counters.rejects
    info.warnings["source_mismatch"] += counters.warnings["source_mismatch"]
    info.warnings += Counter()  # drops zero counts
    info.resyncs += counters.resyncs
    info.lost_pings += sequence.lost_pings
    info.duplicates += sequence.duplicates
    info.restarts += sequence.restarts
