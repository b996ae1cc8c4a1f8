"""What every odometry format offers: bytes in, records and counted rejects out, no I/O."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["Decoder", "DecoderCounters"]

MAX_NAMES = 100
"""Of one counter; no sender has more kinds of messages."""


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

    def heard(self, name: str, size: int, *, whole: bool = True) -> None:
        """Count a piece of `size` bytes that is one frame of that name, or none."""
        if not whole:
            self.bytes_skipped += size
            return
        self.frames += 1
        self.messages[_bounded(self.messages, name)] += 1

    def ignore(self, name: str) -> None:
        """Count a whole frame that says nothing about where the vehicle is."""
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
