"""The pings of a recording, chosen."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording.messages import messages_of
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oculus_driver.recording import Recording
    from oculus_driver.stream import Message


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
        pings = self._decoded(messages_of(recording))
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
