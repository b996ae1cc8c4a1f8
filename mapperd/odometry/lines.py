"""Formats of text lines: the stream cut into lines, each line read by itself."""

import re
from collections.abc import Callable, Iterator

from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["LineDecoder", "ReadLine"]

ReadLine = Callable[[bytes, int | None, DecoderCounters], Odometry | Reject | None]
"""Reads a line without its end, given its arrival. Counts the frame as heard if its check holds.

None: whole, and of no use.
"""

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
