"""What a link does, as a state machine with names that a person can read; no I/O, no clock.

opening ─▶ waiting ─▶ receiving ⇄ silent
   ▲          │            │         │
   └─ backing off ◀────────┴─────────┘   (lost, or silent for too long on a connection)
"""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["LinkPhase", "LinkState", "LinkStatus"]

SECOND_NS = 1_000_000_000
SILENT_NS = 5 * SECOND_NS
RECONNECT_NS = 15 * SECOND_NS
"""A connection that says nothing for so long may be dead without anybody having said so."""
BACK_OFF_NS = tuple(round(s * SECOND_NS) for s in (0.5, 1.0, 2.0, 5.0))


class LinkPhase(StrEnum):
    """What the link does now."""

    CLOSED = "closed"
    OPENING = "opening"
    WAITING = "waiting"
    RECEIVING = "receiving"
    SILENT = "silent"
    BACKING_OFF = "backing off"


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The link at one moment.

    Attributes:
        phase: what it does.
        since_ns: when that began, host clock.
        reason: why, for a person.
        bytes_received: since the start.
        opened: times that it was opened.
        losses: times that it was lost or could not be opened.
    """

    phase: LinkPhase
    since_ns: int
    reason: str
    bytes_received: int
    opened: int
    losses: int

    def time_in_phase_s(self, now_ns: int) -> float:
        """How long it has been so."""
        return (now_ns - self.since_ns) / SECOND_NS


class LinkState:
    """Follows one link. Every method takes the host's time in nanoseconds.

    Args:
        where: the link, for the reasons.
        connects: whether silence may mean a dead connection, to be made anew.
    """

    def __init__(self, where: str, *, connects: bool) -> None:
        self._where = where
        self._connects = connects
        self._phase = LinkPhase.CLOSED
        self._since_ns = 0
        self._reason = "not started"
        self._heard_ns = 0
        self._bytes = self._opened = self._losses = 0
        self._failures = 0

    @property
    def status(self) -> LinkStatus:
        """The link as it is now."""
        return LinkStatus(
            self._phase, self._since_ns, self._reason, self._bytes, self._opened, self._losses
        )

    @property
    def overdue_ns(self) -> int | None:
        """When `tick` has something to say; None where only an event can change anything."""
        if self._phase in (LinkPhase.WAITING, LinkPhase.RECEIVING):
            return self._heard_ns + SILENT_NS
        if self._phase is LinkPhase.SILENT and self._connects:
            return self._heard_ns + RECONNECT_NS
        return None

    def opening(self, now_ns: int) -> None:
        """It is being opened."""
        self._enter(LinkPhase.OPENING, f"opening {self._where}", now_ns)

    def opened(self, now_ns: int) -> None:
        """It is open; nothing has come yet."""
        self._opened += 1
        self._heard_ns = now_ns
        self._enter(LinkPhase.WAITING, f"{self._where} is open, nothing has come", now_ns)

    def received(self, size: int, now_ns: int) -> None:
        """Bytes came."""
        self._bytes += size
        self._heard_ns = now_ns
        self._failures = 0
        if self._phase is not LinkPhase.RECEIVING:
            self._enter(LinkPhase.RECEIVING, f"bytes come from {self._where}", now_ns)

    def tick(self, now_ns: int) -> bool:
        """Look at the time; True where the connection is to be given up."""
        overdue_ns = self.overdue_ns
        if overdue_ns is None or now_ns < overdue_ns:
            return False
        if self._phase is LinkPhase.SILENT:
            return True
        quiet_s = (now_ns - self._heard_ns) / SECOND_NS
        self._enter(
            LinkPhase.SILENT, f"nothing received for {quiet_s:.0f} s on {self._where}", now_ns
        )
        return False

    def lost(self, reason: str, now_ns: int) -> int:
        """It was lost, or could not be opened; returns when to try again."""
        pause_ns = BACK_OFF_NS[min(self._failures, len(BACK_OFF_NS) - 1)]
        self._failures += 1
        self._losses += 1
        self._enter(LinkPhase.BACKING_OFF, reason, now_ns)
        return now_ns + pause_ns

    def closed(self, now_ns: int) -> None:
        """It was closed on purpose."""
        self._enter(LinkPhase.CLOSED, "closed", now_ns)

    def _enter(self, phase: LinkPhase, reason: str, now_ns: int) -> None:
        self._phase, self._since_ns, self._reason = phase, now_ns, reason
