"""The pings of a recording, chosen."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import Message, StreamParser
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oculus_driver.recording import Recording


@dataclass(slots=True)
class Choice:
    """Which pings of a recording are wanted, and what was met on the way.

    Attributes:
        first: ping to begin with, counted from 0.
        step: every how many pings.
        limit: at most so many, None for all.
        ping_id: only pings of this id.
        rejects: why pings could not be decoded, counted.
    """

    first: int = 0
    step: int = 1
    limit: int | None = None
    ping_id: int | None = None
    rejects: Counter[str] = field(default_factory=Counter)

    def of(self, recording: Recording) -> Iterator[Ping]:
        """Yield the chosen pings of an open recording."""
        pings = self._decoded(_messages(recording))
        if self.ping_id is not None:
            pings = (ping for ping in pings if ping.ping_id == self.ping_id)
        return islice(islice(pings, self.first, None, self.step), self.limit)

    def _decoded(self, messages: Iterable[Message]) -> Iterator[Ping]:
        for message in messages:
            if message.message_id != MessageId.PING_RESULT:
                continue
            ping = decode_ping(message)
            if isinstance(ping, Ping):
                yield ping
            else:
                self.rejects[ping.reason] += 1


def _messages(recording: Recording) -> Iterator[Message]:
    from oculus_driver.recording import OCULUS  # noqa: PLC0415 - needs more than numpy

    parser = StreamParser(confirm=True)
    for chunk in recording:
        if chunk.encoding == OCULUS:
            yield from parser.feed(chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
    yield from parser.finish()
