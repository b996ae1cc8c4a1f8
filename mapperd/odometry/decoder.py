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
"""Of one counter; no sender has more kinds of messages."""


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
    """What one decoder has seen; a link's health can be read from top to bottom.

    Attributes:
        bytes_total: bytes that came in.
        bytes_skipped: bytes that belong to no frame.
        frames: frames whose check held, or that have none.
        messages: name to count, of those frames.
        ignored: name to count, of frames that are whole and of no use to odometry.
        records: odometry records that came out.
        warnings: what the sender warns of, to count.
        rejects: reason to count.
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
        """All counts."""
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
        """Count on from `state`."""
        self.bytes_total, self.bytes_skipped = state.bytes_total, state.bytes_skipped
        self.frames, self.records = state.frames, state.records
        self.messages, self.ignored = Counter(state.messages), Counter(state.ignored)
        self.warnings, self.rejects = Counter(state.warnings), Counter(state.rejects)

    def heard(self, name: str, size: int, *, whole: bool = True) -> None:
        """Count a piece of `size` bytes that is one frame of that name, or none."""
        if not whole:
            self.bytes_skipped += size
            return
        self.frames += 1
        self.messages[_bounded(self.messages, name)] += 1

    def ignore(self, name: str) -> None:
        """Count a valid frame without navigation data."""
        self.ignored[_bounded(self.ignored, name)] += 1

    def out(self, result: Odometry | Reject) -> Odometry | Reject:
        """Count what is about to come out, and hand it on."""
        if isinstance(result, Reject):
            self.rejects[result.reason] += 1
        else:
            self.records += 1
        return result


def _bounded(counter: Counter[str], name: str) -> str:
    """The name to count under: those that come over a wire could go on for ever."""
    return name if name in counter or len(counter) < MAX_NAMES else "other"


class Decoder(Protocol):
    """One link's format. Total over any bytes, bounded memory, finds back after garbage."""

    @property
    def counters(self) -> DecoderCounters:
        """What came in so far and what became of it."""

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Take the next bytes; the caller must exhaust the iterator.

        Args:
            data: of a stream any piece, of datagrams exactly one.
            arrival_ns: when they arrived, host clock; None if unknown.
        """

    def restart(self) -> None:
        """Forget what is half received: the link was interrupted."""

    def state(self) -> Any:  # noqa: ANN401 each format has its own
        """Everything that `restore` needs to continue exactly, as a named tuple."""

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """Continue as the decoder of which `state` was taken; the arguments must be the same.

        Args:
            state: of a decoder of the same format; as plain lists where it was stored.

        Raises:
            msgspec.ValidationError: it is no such state.
        """


ReadLine = Callable[[bytes, int | None, DecoderCounters], Odometry | Reject | None]
"""Reads a line without its end, given its arrival. Counts the frame as heard if its check holds.

None: whole, and of no use.
"""


@runtime_checkable
class RememberingReader(Protocol):
    """A `ReadLine` that remembers something between lines."""

    def state(self) -> Any:  # noqa: ANN401 each format has its own
        """As `Decoder.state`."""

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """As `Decoder.restore`."""


class _LineState(NamedTuple):
    counters: CountersState
    rest: bytes
    skipping: bool
    reader: Any


_LINE_END = re.compile(rb"[\r\n]+")


class LineDecoder:
    """Lines that end in CR, LF or both, however the stream was split.

    Args:
        read: reads one line.
        max_line_bytes: a longer one is refused, and skipped to its end.
        datagrams: each piece is whole: its end is the end of a line.

    Attributes:
        counters: what came in and what became of it.
    """

    def __init__(self, read: ReadLine, max_line_bytes: int, *, datagrams: bool = False) -> None:
        self.counters = DecoderCounters()
        self._read = read
        self._max_line_bytes = max_line_bytes
        self._datagrams = datagrams
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Take the next bytes."""
        self.counters.bytes_total += len(data)
        *whole, rest = _LINE_END.split(self._rest + data)
        if self._datagrams:
            whole, rest = [*whole, rest], b""
        self._rest = b""
        for line in whole:
            yield from self._line(line, arrival_ns)
        if self._skipping or len(rest) > self._max_line_bytes:
            yield from self._too_long(rest)
        else:
            self._rest = rest

    def restart(self) -> None:
        """Forget what is half received."""
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

    def _line(self, line: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        if self._skipping or len(line) > self._max_line_bytes:
            yield from self._too_long(line)
            self._skipping = False
            return
        if not line:
            return
        frames = self.counters.frames
        result = self._read(line, arrival_ns, self.counters)
        if self.counters.frames == frames:
            self.counters.bytes_skipped += len(line)
        if result is not None:
            yield self.counters.out(result)

    def _too_long(self, piece: bytes) -> Iterator[Reject]:
        """Skip a piece of a line; one reject for each such line."""
        self.counters.bytes_skipped += len(piece)
        if not self._skipping:
            self._skipping = True
            reject = Reject("too_long", f"a line of more than {self._max_line_bytes} bytes")
            self.counters.out(reject)
            yield reject
