"""Read a raw stream: messages back to back as a liboculus recorder leaves them, no stamps."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.framing import header_fault, read_header
from oculus_driver.recording.chunk import OCULUS, Chunk, Progress
from oculus_driver.stream import StreamParser
from oculus_driver.wire import HEADER, MAX_MESSAGE_SIZE, PAYLOAD_LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterator

RAW_LINK: Final = "sonar"
BLOCK: Final = 1 << 16
_SEARCHED: Final = 2 * MAX_MESSAGE_SIZE
"""Bytes at the start of a file among which a message must be: two of the largest."""


def is_raw_stream(file: BinaryIO) -> bool:
    """Tell whether a file holds an Oculus stream, also one whose beginning is cut or garbage."""
    file.seek(0)
    parser = StreamParser()
    first = file.read(BLOCK)
    if len(first) >= HEADER.size and header_fault(read_header(first, 0), strict=True) is None:
        return True
    block = first
    while block and parser.counters.bytes_total < _SEARCHED:
        parser.feed(block)
        if _has_known(parser):
            return True
        block = file.read(BLOCK)
    parser.finish()
    return _has_known(parser)


def _has_known(parser: StreamParser) -> bool:
    return any(number in PAYLOAD_LIMITS for number in parser.counters.messages)


def read_raw(file: BinaryIO, progress: Progress) -> Iterator[Chunk]:
    """Yield the bytes of a raw stream in blocks; tell in `progress` what belongs to no message."""
    file.seek(0)
    parser = StreamParser(confirm=True)
    while block := file.read(BLOCK):
        progress.bytes_read += len(block)
        parser.feed(block)
        yield Chunk(RAW_LINK, OCULUS, None, block)
    parser.finish()
    rejected = parser.counters.bytes_rejected
    if parser.counters.rejects["truncated"]:
        progress.cut(f"the file ends inside a message; {rejected} bytes belong to no message")
    elif rejected:
        progress.report(f"{rejected} bytes belong to no message")
