"""States, timeouts, actions, status and counters of a link."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


SECOND_NS: Final = 1_000_000_000
_MILLISECOND_NS: Final = 1_000_000


class LinkState(StrEnum):
    """What the link is doing."""

    CLOSED = "closed"
    SEARCHING = "searching"
    CONNECTING = "connecting"
    CONFIGURING = "configuring"
    PINGING = "pinging"
    STANDBY = "standby"
    SILENT = "silent"
    BACKING_OFF = "backing off"


@dataclass(frozen=True, slots=True)
class LinkTimeouts:
    """Timeouts of the link, nanoseconds.

    Silence, reconnection and fallback count in addition to the time of one ping.

    Attributes:
        connect_ns: for the sonar to accept the connection.
        keep_alive_ns: interval of repeated fire messages, 0.2 to 10 s; None: no repetition.
        send_gap_ns: minimum gap between two messages to the sonar.
        silence_ns: without a ping, until the link is "silent".
        reconnect_ns: without any message, until the link reconnects.
        fallback_ns: for the first ping, until the other fire version is tried.
        status_gone_ns: without a status, until the sonar counts as gone.
        back_off_ns: steps of the `BackOff` between connection attempts.
    """

    connect_ns: int = 3 * SECOND_NS
    keep_alive_ns: int | None = SECOND_NS
    send_gap_ns: int = 50 * _MILLISECOND_NS
    silence_ns: int = 2 * SECOND_NS
    reconnect_ns: int = 10 * SECOND_NS
    fallback_ns: int = 5 * SECOND_NS
    status_gone_ns: int = 5 * SECOND_NS
    back_off_ns: tuple[int, ...] = (SECOND_NS // 2, *(s * SECOND_NS for s in (1, 2, 4, 5)))


@dataclass(frozen=True, slots=True)
class Connect:
    """Open a connection to the sonar's data port."""

    address: str


@dataclass(frozen=True, slots=True)
class Disconnect:
    """Drop the connection or the connection attempt."""

    reason: str


@dataclass(frozen=True, slots=True)
class Send:
    """Send one message in one write: the sonar may rely on segment boundaries."""

    data: bytes = field(repr=False)


Action = Connect | Disconnect | Send


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """Status of the link at one moment.

    Attributes:
        state: what the link is doing.
        since_ns: start of the state, host monotonic.
        reason: human-readable reason.
        address: of the sonar, None if unknown.
        fire_version: of the fire messages, 1 or 2.
        failures: consecutive attempts without any message.
    """

    state: LinkState
    since_ns: int
    reason: str
    address: str | None
    fire_version: int
    failures: int

    def time_in_state_s(self, now_ns: int) -> float:
        """Return the time in the present state, seconds."""
        return (now_ns - self.since_ns) / SECOND_NS


@dataclass(frozen=True, slots=True)
class SonarCounters:
    """Counters since the sonar was opened, over all connections.

    `pings` counts each valid ping once: pings = taken + dropped + queued.

    Attributes:
        connections: established connections.
        losses: connections and attempts that failed, ended unexpectedly or were aborted.
        bytes_received: from the sonar.
        bytes_rejected: bytes among these outside messages.
        resyncs: how often synchronisation was lost.
        messages: complete messages by id.
        rejects: unusable messages by reason.
        pings, taken, dropped, queued: valid pings; delivered to a reader; dropped because the
            readers were too slow; waiting for a reader.
        duplicates, lost_pings, restarts: by the ping ids.
        sent: messages sent to the sonar.
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
