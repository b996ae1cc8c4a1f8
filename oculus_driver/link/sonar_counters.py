"""What became of everything that came from a sonar and went to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class SonarCounters:
    """Counts since the sonar was opened, over all connections.

    `pings` are the good ones, each id once: pings = taken + dropped + queued.

    Attributes:
        connections: that stood.
        losses: connections and attempts that ended without our wish, or that were given up.
        bytes_received: from the sonar.
        bytes_rejected: of these, that belong to no message.
        resyncs: times that the start of the next message was lost.
        messages: whole messages by id.
        rejects: messages that could not be used, by reason.
        pings, taken, dropped, queued: good pings; handed to a reader; dropped because readers
            were slow; waiting for one.
        duplicates, lost_pings, restarts: what the ping ids say.
        sent: messages to the sonar.
    """

    connections: int
    losses: int
    bytes_received: int
    bytes_rejected: int
    resyncs: int
    messages: Mapping[int, int] = field(repr=False)
    rejects: Mapping[str, int]
    pings: int
    taken: int
    dropped: int
    queued: int
    duplicates: int
    lost_pings: int
    restarts: int
    sent: int
