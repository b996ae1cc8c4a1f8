"""Names for what the link to a sonar is doing, and what it may be told to do next."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


SECOND_NS: Final = 1_000_000_000
_MILLISECOND_NS: Final = 1_000_000


class LinkState(StrEnum):
    """What the link does now."""

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
    """How long the link waits for what, nanoseconds.

    Silence, reconnection and fallback count beyond the time that one ping may take.

    Attributes:
        connect_ns: for the sonar to accept the connection.
        keep_alive_ns: between repeated fire messages, 0.2 to 10 s; None repeats none.
        send_gap_ns: least time between two messages to the sonar.
        silence_ns: without a ping, before the link is called silent.
        reconnect_ns: of no message at all, before the connection is made anew.
        fallback_ns: for the first ping, before the other fire version is tried.
        status_gone_ns: after which a sonar that sends no status is gone.
        back_off_ns: between attempts to connect; the last one repeats.
    """

    connect_ns: int = 3 * SECOND_NS
    keep_alive_ns: int | None = SECOND_NS
    send_gap_ns: int = 50 * _MILLISECOND_NS
    silence_ns: int = 2 * SECOND_NS
    reconnect_ns: int = 10 * SECOND_NS
    fallback_ns: int = 5 * SECOND_NS
    status_gone_ns: int = 5 * SECOND_NS
    back_off_ns: tuple[int, ...] = (SECOND_NS // 2, *(s * SECOND_NS for s in (1, 2, 4, 5)))

    def retry_delay_ns(self, failures: int, rng: float) -> int:
        """Return the pause after the `failures`-th failure in a row, failures ≥ 1.

        Between half and all of the step, so that hosts that lost the sonar together do not
        come back together.

        Args:
            failures: attempts in a row that came to nothing.
            rng: a random number from 0 to 1.
        """
        step_ns = self.back_off_ns[min(failures, len(self.back_off_ns)) - 1]
        return round(step_ns * (1.0 - 0.5 * rng))


@dataclass(frozen=True, slots=True)
class Connect:
    """Open a connection to the sonar's data port."""

    address: str


@dataclass(frozen=True, slots=True)
class Disconnect:
    """Drop the connection, or the attempt at one."""

    reason: str


@dataclass(frozen=True, slots=True)
class Send:
    """Send one message in one write: the sonar may rely on segment boundaries."""

    data: bytes = field(repr=False)


Action = Connect | Disconnect | Send


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The link at one moment.

    Attributes:
        state: what it does.
        since_ns: when that began, host monotonic.
        reason: why, in words for a person.
        address: of the sonar, None where none is known.
        fire_version: of the fire messages, 1 or 2.
        failures: attempts in a row that brought no message.
    """

    state: LinkState
    since_ns: int
    reason: str
    address: str | None
    fire_version: int
    failures: int

    def time_in_state_s(self, now_ns: int) -> float:
        """Return how long the link has been in this state."""
        return (now_ns - self.since_ns) / SECOND_NS


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
