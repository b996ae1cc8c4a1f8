"""What the summary at the end of an MCAP file says, if there is one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import BinaryIO, Final

from oculus_driver.recording import mcap_records as mcap
from oculus_driver.recording.mcap_records import Opcode

_TAIL: Final = mcap.HEAD.size + mcap.FOOTER.size + len(mcap.MAGIC)
_MAX_RECORDS: Final = 1 << 16
"""Records of a summary that are looked at; what is wanted stands near its beginning."""

_MAX_LENGTH: Final = 1 << 16


@dataclass(slots=True)
class Summary:
    """The part of a summary that reading needs.

    Attributes:
        span_ns: earliest and latest log time, None where not told.
        channels: topic and encoding by number.
    """

    span_ns: tuple[int, int] | None = None
    channels: dict[int, tuple[str, str]] = field(default_factory=dict)


def channel_of(content: bytes) -> tuple[int, str, str] | None:
    """Return number, topic and encoding from a channel record's content, None if damaged."""
    texts = tuple(mcap.strings(content, 2 * mcap.U16.size))
    if len(texts) < 2:  # noqa: PLR2004 - topic and encoding
        return None
    (number,) = mcap.U16.unpack_from(content)
    return number, texts[0], texts[1]


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Return what the summary says; nothing where the file has no sound one. Moves the file."""
    summary = Summary()
    if size < _TAIL:
        return summary
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    if not tail.endswith(mcap.MAGIC) or tail[0] != Opcode.FOOTER:
        return summary
    position, _, _ = mcap.FOOTER.unpack_from(tail, mcap.HEAD.size)
    for _ in range(_MAX_RECORDS if position else 0):
        if position + mcap.HEAD.size > size - _TAIL:
            break
        file.seek(position)
        opcode, length = mcap.HEAD.unpack(file.read(mcap.HEAD.size))
        position += mcap.HEAD.size + length
        if opcode in (Opcode.CHANNEL, Opcode.STATISTICS) and length <= _MAX_LENGTH:
            _take(summary, opcode, file.read(length))
    return summary


def _take(summary: Summary, opcode: int, content: bytes) -> None:
    if opcode == Opcode.CHANNEL:
        channel = channel_of(content)
        if channel is not None:
            summary.channels[channel[0]] = channel[1:]
    elif len(content) >= mcap.STATISTICS.size:
        messages, *_, first_ns, last_ns = mcap.STATISTICS.unpack_from(content)
        if messages and first_ns:
            summary.span_ns = (first_ns, last_ns)
