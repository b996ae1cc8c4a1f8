"""The interface of all odometry formats, and formats of text lines."""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec

from mapperd.errors import Reject
from mapperd.odometry.records import Odometry

__all__ = [
    "CountersState",
    "Decoder",
    "DecoderCounters",
    "LineDecoder",
    "ReadLine",
    "RememberingReader",
]

MAX_NAMES = 100
"""Maximum number of names in a counter; no sender has more kinds of messages."""


class CountersState(NamedTuple):
    """The attributes of `DecoderCounters`."""

    bytes_total: int
    bytes_skipped: int
    frames: int
    messages: dict[str, int]
    ignored: dict[str, int]
    warnings: dict[str, int]
    records: int
    rejects: dict[str, int]


@dataclass(slots=True)
class DecoderCounters:
    """Counters of one decoder, from bytes to records; they show a link's health.

    Attributes:
        bytes_total: received bytes.
        bytes_skipped: bytes outside of frames.
        frames: frames with a valid checksum, or of a format without one.
        messages: number of those frames, by name.
        ignored: number of valid frames without odometry, by name.
        records: decoded odometry records.
        warnings: number of warnings of the sender, by kind.
        rejects: number of rejects, by reason.
    """

    bytes_total: int = 0
    bytes_skipped: int = 0
    frames: int = 0
    messages: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)
    records: int = 0
    rejects: Counter[str] = field(default_factory=Counter)

    def state(self) -> CountersState:
        """Return all counts."""
        return CountersState(
            self.bytes_total,
            self.bytes_skipped,
            self.frames,
            dict(self.messages),
            dict(self.ignored),
            dict(self.warnings),
            self.records,
            dict(self.rejects),
        )

    def restore(self, state: CountersState) -> None:
        """Continue counting from a state."""
        self.bytes_total, self.bytes_skipped = state.bytes_total, state.bytes_skipped
        self.frames, self.records = state.frames, state.records
        self.messages, self.ignored = Counter(state.messages), Counter(state.ignored)
        self.warnings, self.rejects = Counter(state.warnings), Counter(state.rejects)

    def heard(self, name: str, size: int, *, whole: bool = True) -> None:
        """Count a piece of `size` bytes that is one frame with this name, or no frame."""
        if not whole:
            self.bytes_skipped += size
            return
        self.frames += 1
        self.messages[_bounded(self.messages, name)] += 1

    def ignore(self, name: str) -> None:
        """Count a valid frame without navigation data."""
        self.ignored[_bounded(self.ignored, name)] += 1

    def out(self, result: Odometry | Reject) -> Odometry | Reject:
        """Count a result and return it."""
        if isinstance(result, Reject):
            self.rejects[result.reason] += 1
        else:
            self.records += 1
        return result


def _bounded(counter: Counter[str], name: str) -> str:
    """Return the name to count under; names from a wire could be endless."""
    return name if name in counter or len(counter) < MAX_NAMES else "other"


class Decoder(Protocol):
    """Decoder of one link. Accepts any bytes, uses bounded memory, resynchronizes after garbage."""

    @property
    def counters(self) -> DecoderCounters:
        """Counters of all bytes and frames so far."""

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Decode the next bytes; the caller must exhaust the iterator.

        Args:
            data: any piece of a stream, or exactly one datagram.
            arrival_ns: arrival time, host clock; None if unknown.
        """

    def restart(self) -> None:
        """Discard partial data after an interruption of the link."""

    def state(self) -> Any:  # noqa: ANN401 each format has its own
        """Return the state for `restore`, as a named tuple."""

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """Continue as the decoder of which `state` was taken; the arguments must be the same.

        Args:
            state: state of a decoder of the same format; plain lists if it was stored.

        Raises:
            msgspec.ValidationError: the state is invalid.
        """


ReadLine = Callable[[bytes, int | None, DecoderCounters], Odometry | Reject | None]
"""Decodes a line without its end, given its arrival. Counts the frame if its checksum is valid.

None: a valid line without odometry.
"""


@runtime_checkable
class RememberingReader(Protocol):
    """A `ReadLine` with a state between lines."""

    def state(self) -> Any:  # noqa: ANN401 each format has its own
        """As `Decoder.state`."""

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """As `Decoder.restore`."""


class _LineState(NamedTuple):
    counters: CountersState
    rest: bytes
    skipping: bool
    reader: Any


_LINE_END = re.compile(rb"([\r\n]+)")


class LineDecoder:
    """Decodes lines that end in CR, LF or both, split in any way.

    Args:
        read: decodes one line.
        max_line_bytes: longer lines are rejected and skipped.
        datagrams: the end of each piece ends a line.

    Attributes:
        counters: counters of this decoder.
    """

    def __init__(self, read: ReadLine, max_line_bytes: int, *, datagrams: bool = False) -> None:
        self.counters = DecoderCounters()
        self._read = read
        self._max_line_bytes = max_line_bytes
        self._datagrams = datagrams
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Decode the next bytes."""
        self.counters.bytes_total += len(data)
        *whole, rest = _LINE_END.split(self._rest + data)
        if self._datagrams:
            whole, rest = [*whole, rest, b""], b""
        self._rest = b""
        for line, end in zip(whole[::2], whole[1::2], strict=True):
            yield from self._line(line, len(end), arrival_ns)
        if self._skipping or len(rest) > self._max_line_bytes:
            yield from self._too_long(rest)
        else:
            self._rest = rest

    def restart(self) -> None:
        """Discard partial data."""
        self.counters.bytes_skipped += len(self._rest)
        self._rest, self._skipping = b"", False

    def state(self) -> _LineState:
        """As `Decoder.state`."""
        reader = self._read.state() if isinstance(self._read, RememberingReader) else None
        return _LineState(self.counters.state(), self._rest, self._skipping, reader)

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """As `Decoder.restore`."""
        counters, self._rest, self._skipping, reader = msgspec.convert(
            state, _LineState, strict=False
        )
        self.counters.restore(counters)
        if isinstance(self._read, RememberingReader):
            self._read.restore(reader)

    def _line(
        self, line: bytes, end_bytes: int, arrival_ns: int | None
    ) -> Iterator[Odometry | Reject]:
        if self._skipping or len(line) > self._max_line_bytes:
            yield from self._too_long(line)
            self._skipping = False
            return
        if not line:
            return
        frames = self.counters.frames
        result = self._read(line, arrival_ns, self.counters)
        if self.counters.frames == frames:
            self.counters.bytes_skipped += len(line) + end_bytes
        if result is not None:
            yield self.counters.out(result)

    def _too_long(self, piece: bytes) -> Iterator[Reject]:
        """Skip a piece of a too long line; each such line is one reject."""
        self.counters.bytes_skipped += len(piece)
        if not self._skipping:
            self._skipping = True
            reject = Reject("too_long", f"a line of more than {self._max_line_bytes} bytes")
            self.counters.out(reject)
            yield reject
