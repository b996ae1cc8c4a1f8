"""Split a byte stream into messages and count everything else."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from oculus_driver.framing import (
    CANDIDATE,
    CANDIDATE_SIZE,
    Accept,
    FrameChecker,
    NeedMore,
    SkipBytes,
)
from oculus_driver.wire import PAYLOAD_LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_MAX_STAMPS = 1 << 16
"""Arrival times kept for one unfinished message; beyond this every second one is dropped."""

_UNCONFIRMED = frozenset({"unconfirmed_end"})


@dataclass(frozen=True, slots=True)
class Message:
    """One complete message of the stream.

    Attributes:
        message_id: see `oculus_driver.wire.MessageId`; other ids occur.
        version: version of the header; 0 means 1.
        source_id: low 16 bits of the sonar's device id.
        part_number: of the sender; 0 from older firmware.
        data: all bytes including the header, owned by the message.
        offset: offset of the first byte in the stream.
        arrival_ns: arrival time of the chunk that contained the first byte, None if it had none.
        warnings: unconfirmed_end: no message follows, or another ping may start inside. Either the
            message is complete and foreign bytes follow it, or bytes inside it are missing or
            surplus. The stream does not contain enough information to distinguish these cases.
    """

    message_id: int
    version: int
    source_id: int
    part_number: int
    data: bytes = field(repr=False)
    offset: int
    arrival_ns: int | None
    warnings: frozenset[str] = frozenset()


@dataclass(slots=True)
class StreamCounters:
    """Counters of a parser. After `finish`, total bytes = message bytes + rejected bytes.

    Attributes:
        bytes_total: bytes fed.
        bytes_rejected: bytes outside messages.
        resyncs: how often synchronisation was lost.
        messages: messages by id.
        rejects: by reason: bad_magic, oversize, unknown_id, unknown_version, short_message,
            size_mismatch, truncated, bytes_missing (another ping starts inside the ping). A
            skipped message with an unknown id counts here, too.
        warnings: by reason: source_mismatch (the source id differs from the previous message's),
            unconfirmed_end (see `Message`).
    """

    bytes_total: int = 0
    bytes_rejected: int = 0
    resyncs: int = 0
    messages: Counter[int] = field(default_factory=Counter)
    rejects: Counter[str] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)


class StreamParserState(NamedTuple):
    """State of a `StreamParser`.

    Attributes:
        bytes_total, bytes_rejected, resyncs, messages, rejects, warnings: as `StreamCounters`.
        source_id: the sonar's id, None until it is known.
        pending: bytes fed but not parsed yet.
        base: stream offset of the first of them.
        needed: pending bytes needed for the next decision.
        synchronised: False while searching for the start of a message.
        lost_at: stream offset at which synchronisation was lost.
        stamp_offsets, stamps: stream offsets from which on arrival times apply.
    """

    bytes_total: int
    bytes_rejected: int
    resyncs: int
    messages: dict[int, int]
    rejects: dict[str, int]
    warnings: dict[str, int]
    source_id: int | None
    pending: bytes
    base: int
    needed: int
    synchronised: bool
    lost_at: int
    stamp_offsets: list[int]
    stamps: list[int | None]


class MessageBounds(NamedTuple):
    """Message boundaries in a piece of a stream; offsets from the start of the piece.

    Attributes:
        start: offset of the first message that begins in the piece, complete or not; the size of
            the piece if none does.
        end: offset up to which the stream is parsed: the end of the last complete message, or the
            size of the piece. Negative if an incomplete message began in an earlier piece.
    """

    start: int
    end: int


class Framing(NamedTuple):
    """What a parser found in a piece of its stream; another parser of the same bytes may adopt it.

    Attributes:
        messages: those that the piece completes.
        bounds: message boundaries in the piece.
        begin: stream offset of the first byte of the piece.
        synchronised, source_id: of the parser, after the piece.
    """

    messages: tuple[Message, ...]
    bounds: MessageBounds
    begin: int
    synchronised: bool
    source_id: int | None


class StreamParser:
    """Splits a TCP stream, or a recording of one, into messages. Never raises on any bytes.

    The messages do not depend on how the stream is split into chunks. Time is linear in the number
    of bytes for any content. Memory is bounded by the largest message (16 MiB) plus one chunk. The
    start of the stream is assumed to be the start of a message, as on a new connection; otherwise
    one resynchronisation is counted.

    If bytes are missing inside a ping, the ping extends into the next one. It is rejected
    (bytes_missing) and the next ping is found, with and without `confirm`. Missing bytes after
    which all sizes fit, such as exactly one ping, are not detected.

    Args:
        source_id: the sonar's id (low 16 bits of its device id). None: learn it from the pings.
        confirm: hold each ping back until the next header has arrived, and warn (unconfirmed_end)
            without one. For recordings. Without it a ping is returned with its last byte,
            unless another ping seems to start inside it. Without it the next ping is lost if
            exactly one byte is missing.
    """

    def __init__(self, source_id: int | None = None, *, confirm: bool = False) -> None:
        self.counters = StreamCounters()
        self._source_id = source_id
        self._confirm = confirm
        self._buffer = bytearray()
        self._position = 0  # in the buffer; the bytes before it are parsed
        self._base = 0  # stream offset of the buffer's first byte
        self._needed = 0  # buffer length needed for the next decision
        self._synchronised = True
        self._lost_at = 0
        self._stamp_offsets: list[int] = []
        self._stamps: list[int | None] = []

    @property
    def synchronised(self) -> bool:
        """False while searching for the start of a message."""
        return self._synchronised

    @property
    def source_id(self) -> int | None:
        """The sonar's id, None until it is known."""
        return self._source_id

    @property
    def pending_bytes(self) -> int:
        """Bytes fed but not parsed yet: the received part of an incomplete message."""
        return len(self._buffer) - self._position

    @property
    def bytes_since_lost(self) -> int:
        """Bytes fed since synchronisation was lost; 0 while synchronised."""
        return 0 if self._synchronised else self._base + len(self._buffer) - self._lost_at

    def state(self) -> StreamParserState:
        """Return everything that `restore` needs to continue exactly; between two feeds."""
        counters = self.counters
        return StreamParserState(
            counters.bytes_total,
            counters.bytes_rejected,
            counters.resyncs,
            dict(counters.messages),
            dict(counters.rejects),
            dict(counters.warnings),
            self._source_id,
            bytes(self._buffer),
            self._base,
            self._needed,
            self._synchronised,
            self._lost_at,
            list(self._stamp_offsets),
            list(self._stamps),
        )

    def restore(self, state: StreamParserState) -> None:
        """Continue as the parser of which `state` was taken; the arguments must be the same."""
        self.counters = StreamCounters(
            state.bytes_total,
            state.bytes_rejected,
            state.resyncs,
            Counter(state.messages),
            Counter(state.rejects),
            Counter(state.warnings),
        )
        self._source_id = state.source_id
        self._buffer, self._position = bytearray(state.pending), 0
        self._base, self._needed = state.base, state.needed
        self._synchronised, self._lost_at = state.synchronised, state.lost_at
        self._stamp_offsets, self._stamps = list(state.stamp_offsets), list(state.stamps)

    def feed(
        self,
        data: bytes | bytearray | memoryview,
        arrival_ns: int | None = None,
        *,
        gap_before: bool = False,
    ) -> list[Message]:
        """Feed the next bytes of the stream and return the messages that they complete.

        Args:
            data: any number of bytes; copied.
            arrival_ns: arrival time of the bytes on any clock, or None.
            gap_before: bytes are missing in front of these. Pending bytes are parsed as at the end
                of the stream, an incomplete message counts as truncated, and the parser
                resynchronises.
        """
        messages = self._parse_before_gap() if gap_before else []
        before = len(self._buffer)
        self._stamp(self._base + before, arrival_ns)
        self._buffer += data
        self.counters.bytes_total += len(self._buffer) - before
        if len(self._buffer) >= self._needed:
            messages += self._parse(final=False)
        return messages

    def bounds(self, messages: list[Message], size: int) -> MessageBounds:
        """Return the message boundaries in the last fed bytes.

        Args:
            messages: returned by `feed` for these bytes.
            size: number of these bytes.
        """
        first = self.counters.bytes_total - size
        end = size - self.pending_bytes
        begun = end if end >= 0 else size
        return MessageBounds(
            next((m.offset - first for m in messages if m.offset >= first), begun), end
        )

    def framing(self, messages: list[Message], size: int) -> Framing:
        """Return what was found in the last fed bytes; arguments as for `bounds`."""
        bounds, begin = self.bounds(messages, size), self.counters.bytes_total - size
        return Framing(tuple(messages), bounds, begin, self._synchronised, self._source_id)

    def adopt(self, pieces: Iterable[tuple[int, int | None]], messages: Sequence[Message]) -> bool:
        """Take over messages instead of being fed their bytes; the state becomes the same.

        Only for messages that another parser in the same state got from the same bytes. Any that
        affect more than the counters of bytes and messages are not taken over.

        Args:
            pieces: sizes and arrival times of the bytes after the pending ones.
            messages: found in the pending bytes and these.

        Returns:
            False if nothing was taken over.
        """
        sizes = [(size, arrival_ns) for size, arrival_ns in pieces if size]
        total = sum(size for size, _ in sizes)
        pending = len(self._buffer)
        if (
            not self._synchronised
            or sum(len(one.data) for one in messages) != pending + total
            or any(one.source_id != self._source_id or one.warnings for one in messages)
            or any(one.message_id not in PAYLOAD_LIMITS for one in messages)
        ):
            return False
        end = self._base + pending
        for size, arrival_ns in sizes:
            self._stamp(end, arrival_ns)
            end += size
        self.counters.bytes_total += total
        self.counters.messages.update(one.message_id for one in messages)
        self._buffer.clear()
        self._base, self._needed = end, 0
        self._discard_parsed()
        return True

    def finish(self) -> list[Message]:
        """Parse the pending bytes at the end of the stream; the rest counts as truncated.

        Feeding more bytes afterwards starts a new stream. Its offsets continue.
        """
        messages = self._parse(final=True)
        self._synchronised = True
        return messages

    def _parse_before_gap(self) -> list[Message]:
        """Parse the bytes in front of a gap, then resynchronise."""
        before = self._synchronised, self.counters.resyncs
        messages = self._parse(final=True)
        if self._synchronised or before == (True, self.counters.resyncs):
            self._synchronised = False
            self._lost_at = self._base
            self.counters.resyncs += 1
        return messages

    def _parse(self, *, final: bool) -> list[Message]:
        messages: list[Message] = []
        self._needed = 0
        while self._synchronised or self._find_candidate(final=final):
            if self._position == len(self._buffer):
                break
            checker = FrameChecker(self._synchronised, self._source_id, final, self._confirm)
            match checker.check(self._buffer, self._position):
                case Accept() as accepted:
                    messages.append(self._emit(accepted))
                case SkipBytes(reason, skip):
                    self._skip(reason, skip)
                case NeedMore(size):
                    self._needed = self._position + size
                    break
        self._discard_parsed()
        return messages

    def _find_candidate(self, *, final: bool) -> bool:
        """Move to the next possible header and count the skipped bytes."""
        found = CANDIDATE.search(self._buffer, self._position)
        if found is not None:
            self._reject(found.start() - self._position)
            return True
        left = len(self._buffer) - self._position
        self._reject(left if final else max(0, left - CANDIDATE_SIZE + 1))
        return False

    def _emit(self, accepted: Accept) -> Message:
        header, size, start = accepted.header, accepted.size, self._position
        offset = self._base + start
        with memoryview(self._buffer) as view:
            data = bytes(view[start : start + size])
        self._position += size
        self._synchronised = True
        self.counters.messages[header.message_id] += 1
        if header.message_id not in PAYLOAD_LIMITS:
            self.counters.rejects["unknown_id"] += 1
        if self._source_id not in (None, header.source_id):
            self.counters.warnings["source_mismatch"] += 1
        if accepted.proven:
            self._source_id = header.source_id
        warnings = frozenset[str]() if accepted.confirmed else _UNCONFIRMED
        self.counters.warnings.update(warnings)
        return Message(
            header.message_id,
            header.version,
            header.source_id,
            header.part_number,
            data,
            offset,
            self._stamp_at(offset),
            warnings,
        )

    def _skip(self, reason: str, skip: int) -> None:
        """Skip bytes at which no message starts. Noise counts once, each rejected ping once."""
        if self._synchronised or reason == "bytes_missing":
            self.counters.rejects[reason] += 1
        if self._synchronised:
            self._synchronised = False
            self._lost_at = self._base + self._position
            self.counters.resyncs += reason != "truncated"
        self._reject(skip)

    def _reject(self, count: int) -> None:
        self._position += count
        self.counters.bytes_rejected += count

    def _stamp(self, offset: int, arrival_ns: int | None) -> None:
        if self._stamps and self._stamps[-1] == arrival_ns:
            return
        if self._stamp_offsets and self._stamp_offsets[-1] == offset:  # after an empty chunk
            self._stamps[-1] = arrival_ns
            return
        self._stamp_offsets.append(offset)
        self._stamps.append(arrival_ns)
        if len(self._stamps) > _MAX_STAMPS:
            del self._stamp_offsets[1::2], self._stamps[1::2]

    def _stamp_at(self, offset: int) -> int | None:
        return self._stamps[bisect_right(self._stamp_offsets, offset) - 1]

    def _discard_parsed(self) -> None:
        del self._buffer[: self._position]
        self._base += self._position
        self._needed = max(0, self._needed - self._position)
        self._position = 0
        current = bisect_right(self._stamp_offsets, self._base) - 1
        if current > 0:
            del self._stamp_offsets[:current], self._stamps[:current]
