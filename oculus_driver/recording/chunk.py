"""What a recording yields, and what is known about a file while it is read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from oculus_driver.stream import Message, StreamParser

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


OCULUS: Final = "oculus"
"""Encoding of a link that carries an Oculus TCP stream, in any fragmentation."""

OCULUS_STATUS: Final = "oculus-status"
"""Encoding of a link that carries one status datagram of a sonar in each chunk."""

ODOMETRY_NATIVE: Final = "odometry-native"
"""Encoding of a link that carries one msgpack odometry record in each chunk."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that came in together.

    Attributes:
        link: where they came from, such as "sonar".
        encoding: what they are: "oculus", "oculus-status", "odometry-native", or another name.
        arrival_ns: when they came, nanoseconds since 1970 UTC, or None where not recorded.
        data: the bytes as they came.
        gap_before: bytes of this link are known to be missing between these and those before.
    """

    link: str
    encoding: str
    arrival_ns: int | None
    data: bytes = field(repr=False)
    gap_before: bool = False


@dataclass(slots=True)
class Progress:
    """What reading a file has shown so far.

    Attributes:
        bytes_read: of the file.
        truncated: the file ends before its content does.
        damage: the first thing that is wrong with the file, for a person, or None.
        faults: how many things were wrong.
        read_error: what the disk said, where it did not let the file be read to its end.
        first_ns, last_ns: earliest and latest stamp.
        metadata: of the recording, by key.
    """

    bytes_read: int = 0
    truncated: bool = False
    damage: str | None = None
    faults: int = 0
    read_error: OSError | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def report(self, text: str) -> None:
        """Note that something is wrong; the first text is kept, all are counted."""
        self.faults += 1
        if self.damage is None:
            self.damage = text

    def report_truncation(self, text: str) -> None:
        """Note that the file ends too early."""
        self.truncated = True
        self.report(text)

    def note_stamp(self, stamp_ns: int | None) -> None:
        """Note a stamp."""
        if stamp_ns is None:
            return
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = stamp_ns if self.last_ns is None else max(self.last_ns, stamp_ns)


_MAX_LINKS: Final = 64


def messages_of(chunks: Iterable[Chunk]) -> Iterator[Message]:
    """Yield the messages of all sonars in a recording; links beyond the 64th are passed over."""
    parsers: dict[str, StreamParser] = {}
    for chunk in chunks:
        if chunk.encoding != OCULUS:
            continue
        if chunk.link not in parsers and len(parsers) < _MAX_LINKS:
            parsers[chunk.link] = StreamParser(confirm=True)
        parser = parsers.get(chunk.link)
        if parser is not None:
            yield from parser.feed(chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
    for parser in parsers.values():
        yield from parser.finish()
