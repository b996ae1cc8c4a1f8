"""Chunks of a recording, the progress of reading a file, and the messages in chunks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from oculus_driver.stream import Message, StreamParser

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


OCULUS: Final = "oculus"
"""Encoding of a link with an Oculus TCP stream, in any fragmentation."""

OCULUS_STATUS: Final = "oculus-status"
"""Encoding of a link with one status datagram of a sonar per chunk."""

ODOMETRY_NATIVE: Final = "odometry-native"
"""Encoding of a link with one msgpack odometry record per chunk."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes received together.

    Attributes:
        link: name of their source, such as "sonar".
        encoding: "oculus", "oculus-status", "odometry-native", or another name.
        arrival_ns: arrival, nanoseconds since 1970 UTC, or None if not recorded.
        data: the received bytes.
        gap_before: bytes of this link are missing between the previous chunk and this one.
        damaged: a checksum over these and other bytes fails, so they may be wrong, and the stamp.
    """

    link: str
    encoding: str
    arrival_ns: int | None
    data: bytes = field(repr=False)
    gap_before: bool = False
    damaged: bool = False


class DamagedPart(NamedTuple):
    """Part of a file whose checksum fails: its offset and its size in bytes."""

    offset: int
    bytes: int


_MAX_PARTS: Final = 1000


@dataclass(slots=True)
class Progress:
    """Progress and problems of reading a file.

    Attributes:
        bytes_read: of the file.
        truncated: the file ends before its content does.
        damage: the first problem, human-readable, or None.
        faults: number of problems.
        damaged_parts: the first 1000 parts whose checksum fails.
        damaged_bytes: size of all of them.
        link_losses: gaps that the recorder marked, as after a lost connection; no damage.
        data_lost: damage inside the file may have cost data, or the disk failed.
        read_error: error of the disk if the file could not be read to its end.
        first_ns, last_ns: earliest and latest stamp.
        metadata: of the recording, by key.
    """

    bytes_read: int = 0
    truncated: bool = False
    damage: str | None = None
    faults: int = 0
    damaged_parts: list[DamagedPart] = field(default_factory=list)
    damaged_bytes: int = 0
    link_losses: int = 0
    data_lost: bool = False
    read_error: OSError | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def report(self, text: str) -> None:
        """Count a problem that may have cost data."""
        self.data_lost = True
        self._count(text)

    def report_damaged(self, offset: int, size: int, fault: str) -> None:
        """Count a part of the file whose checksum fails."""
        self.damaged_bytes += size
        if len(self.damaged_parts) < _MAX_PARTS:
            self.damaged_parts.append(DamagedPart(offset, size))
        self._count(f"damaged chunk at byte {offset}: {fault}")

    def report_truncation(self, text: str) -> None:
        """Count a premature end of the file."""
        self.truncated = True
        self._count(text)

    def _count(self, text: str) -> None:
        """Count a problem; only the first text is kept."""
        self.faults += 1
        if self.damage is None:
            self.damage = text

    def note_stamp(self, stamp_ns: int | None) -> None:
        """Update the time span with a stamp."""
        if stamp_ns is None:
            return
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = stamp_ns if self.last_ns is None else max(self.last_ns, stamp_ns)


_MAX_LINKS: Final = 64


def messages_of(chunks: Iterable[Chunk]) -> Iterator[Message]:
    """Yield the messages of all sonars in a recording; links beyond the 64th are skipped."""
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
