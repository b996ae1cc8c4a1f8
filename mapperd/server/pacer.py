"""Limits on bytes in flight and bytes per second, from what TCP reports about the link.

Bytes in a buffer between the daemon and a client are old when they arrive, and everything after
them waits. TCP decides how fast packets go and which are sent again, and it reports the rate and
the round trip that it measured. The daemon gives TCP no more than it sends within moments:

- bytes that TCP has not sent yet stay below a fraction of a second of that rate;
- bytes in the network stay below one window: what the wire holds and a short queue. A congestion
  control that fills the network's buffers (all but BBR do) is held by this window alone.
"""

import socket
import struct
from dataclasses import dataclass
from typing import Protocol

__all__ = [
    "FIRST_BYTES",
    "FIRST_RATE",
    "LOCAL_WINDOW",
    "MAX_IN_FLIGHT",
    "MIN_WINDOW",
    "Budget",
    "Pacer",
    "Socket",
    "TcpState",
    "tcp_state",
    "tune",
]

BURST_S, MIN_BURST = 0.2, 2048


class Budget:
    """A token bucket of bytes. Callers pass the time in seconds; it never goes back.

    Args:
        bytes_per_s: limit in the long run; 0 has no limit.

    Attributes:
        bytes_per_s: as given; may be changed.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.bytes_per_s = bytes_per_s
        self._left = float(MIN_BURST)
        self._filled_s: float | None = None

    @property
    def burst(self) -> float:
        """Capacity in bytes."""
        return max(BURST_S * self.bytes_per_s, MIN_BURST)

    def left(self, now_s: float) -> float:
        """Bytes that may be sent now, if there is a limit; below 0 is debt."""
        passed_s = 0.0 if self._filled_s is None else max(0.0, now_s - self._filled_s)
        self._filled_s = now_s
        self._left = min(self.burst, self._left + passed_s * self.bytes_per_s)
        return self._left

    def spend(self, size: int, now_s: float) -> None:
        """Take `size` bytes out."""
        self._left = self.left(now_s) - (size if self.bytes_per_s else 0)


UNSENT_S, MIN_UNSENT = 0.12, 2048
"""Limit of what TCP has not sent yet: time at the link's rate; more than between two ticks."""

QUEUE_S, MIN_WINDOW = 0.2, 4096
"""Time that packets may wait in the network, and the smallest window."""

MAX_IN_FLIGHT = 1 << 20
"""Maximum bytes that a client has not acknowledged."""

FIRST_RATE, FIRST_BYTES = 16_000, 8192
"""Smallest rate in bytes a second until so many bytes have arrived: few bytes measure no rate."""

LOCAL_RATE, LOCAL_WINDOW = 100e6, 1 << 16
"""Rate of a Unix socket in bytes a second, and maximum bytes in flight on it."""

NEARLY_ALL = 0.75
"""Share of the maximum room at which a message is sent even if it does not fit."""

SMALLEST_S, MAX_SMALLEST_BYTES = 0.12, 16_384
"""Smallest message worth sending while more is to come: what the link delivers within a time, at
most some bytes."""


class Pacer:
    """Pacing of one connection. Callers pass the time in seconds; it never goes back.

    Args:
        bytes_per_s: limit in the long run; 0 has no limit.

    Attributes:
        budget: of the client.
        sent, acked: bytes so far.
        rate: bytes a second that the link delivers, as TCP reports it; None without TCP.
        round_trip_s: smallest of a packet, as TCP reports it; None where it does not.
        trip_s: that of now; longer where packets wait in the network.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.budget = Budget(bytes_per_s)
        self.sent = self.acked = 0
        self.rate: float | None = None
        self.round_trip_s: float | None = None
        self.trip_s: float | None = None
        self._unsent = self._in_network = 0
        self._quiet_since_s = 0.0

    @property
    def bytes_per_s(self) -> int:
        """Limit of the budget."""
        return self.budget.bytes_per_s

    @property
    def in_flight(self) -> int:
        """Bytes that were sent and are not acknowledged."""
        return self.sent - self.acked

    @property
    def allowed_rate(self) -> float:
        """Bytes a second that the link and the budget allow."""
        rate = LOCAL_RATE if self.rate is None else self.rate
        return min(rate, self.bytes_per_s) if self.bytes_per_s else rate

    @property
    def window(self) -> float:
        """Bytes that may be in the network."""
        if self.rate is None:
            return LOCAL_WINDOW
        calm_s = (self.round_trip_s or 0.0) + QUEUE_S
        # The rate may be of a faster link: then packets take long, and the queue has to shrink.
        calm = self.rate * calm_s * min(1.0, calm_s / (self.trip_s or calm_s))
        return min(max(calm, MIN_WINDOW), MAX_IN_FLIGHT)

    @property
    def max_in_flight(self) -> int:
        """Bytes that may be sent and not acknowledged."""
        return LOCAL_WINDOW if self.rate is None else MAX_IN_FLIGHT

    @property
    def _max_unsent(self) -> float:
        rate = LOCAL_RATE if self.rate is None else self.rate
        return min(max(UNSENT_S * rate, MIN_UNSENT), self.max_in_flight)

    def room(self, now_s: float) -> int:
        """Return how many bytes may be sent now; it can be negative."""
        room = min(
            self.max_in_flight - self.in_flight,
            self._max_unsent - self._unsent,
            self.window - self._in_network - self._unsent,
        )
        return int(min(room, self.budget.left(now_s)) if self.bytes_per_s else room)

    def fits(self, size: int, now_s: float) -> bool:
        """Return whether `size` bytes may be sent: half fit, or little more could ever fit."""
        room = self.room(now_s)
        most = min(self.window, self._max_unsent)
        if self.bytes_per_s:
            most = min(most, self.budget.burst)
        return room > 0 and (size // 2 <= room or room >= NEARLY_ALL * most)

    def least(self) -> int:
        """Smallest message worth sending while more is to come, in bytes."""
        ever = min(self.window, self._max_unsent)
        return int(min(SMALLEST_S * self.allowed_rate, MAX_SMALLEST_BYTES, ever / 2))

    def is_idle_for(self, size: int) -> bool:
        """Return whether little is in flight and the link delivers `size` bytes in moments."""
        moments_s = (self.round_trip_s or 0.0) + UNSENT_S
        most = min(max(moments_s * self.allowed_rate, MIN_UNSENT), self.max_in_flight)
        return self.in_flight <= most / 2 and size <= most

    def note_sent(self, size: int, now_s: float) -> None:
        """Note that `size` bytes were sent."""
        self.budget.spend(size, now_s)
        if not self.in_flight:
            self._quiet_since_s = now_s
        self.sent += size
        self._unsent += size

    def note_link(
        self,
        unsent: int,
        round_trip_s: float | None = None,
        trip_s: float | None = None,
        in_network: int = 0,
        rate: float | None = None,
    ) -> None:
        """Note the state of the connection.

        Args:
            unsent: bytes that TCP was given and has not sent.
            round_trip_s: smallest of a packet; None where TCP does not report it.
            trip_s: that of now, smoothed.
            in_network: bytes of packets that were sent and have neither arrived nor been lost.
            rate: bytes a second that the network delivers; None if the connection is not TCP.
        """
        self._unsent = unsent
        # TCP counts small packets as full ones.
        self._in_network = min(in_network, max(self.in_flight - unsent, 0))
        self.round_trip_s, self.trip_s = round_trip_s, trip_s
        is_new = rate is not None and self.acked < FIRST_BYTES
        self.rate = max(rate or 0.0, FIRST_RATE) if is_new else rate

    def note_ack(self, acked: int, now_s: float) -> bool:
        """Note bytes that arrived since the beginning; return whether the number is possible."""
        if not self.acked <= acked <= self.sent:
            return False
        if acked > self.acked:
            self.acked = acked
            self._unsent = min(self._unsent, self.in_flight)
            self._in_network = min(self._in_network, self.in_flight)
            self._quiet_since_s = now_s
        return True

    def quiet_s(self, now_s: float) -> float:
        """Seconds without an acknowledgement while something is in flight."""
        return now_s - self._quiet_since_s if self.in_flight else 0.0


UNSENT_BYTES = 16384
"""Bytes that the kernel queues beyond what is on the wire: more would only delay newer data."""

CALM = b"bbr"
"""The congestion control that does not fill the network's buffers."""

NAME_BYTES = 16

INFO = struct.Struct("<16xI4xIIII28xI72xII8xQ")
"""Linux's `struct tcp_info`: tcpi_snd_mss; packets in tcpi_unacked, of which tcpi_sacked have
arrived and tcpi_lost have not, and tcpi_retrans that were sent again; tcpi_rtt in microseconds;
tcpi_notsent_bytes; tcpi_min_rtt; tcpi_delivery_rate in bytes a second."""

TCP_CC_INFO = 26
BBR_INFO = struct.Struct("<QI")
"""The beginning of Linux's `struct tcp_bbr_info`: the rate that it found, in bytes a second, and
the smallest round trip of the last seconds, in microseconds."""


class Socket(Protocol):
    """The part of a socket that is needed; asyncio's sockets have no more."""

    @property
    def family(self) -> int:
        """Address family."""

    def getsockopt(self, level: int, name: int, size: int, /) -> bytes:
        """Read an option as bytes."""


@dataclass(frozen=True, slots=True)
class TcpState:
    """State of a connection, as the kernel reports it.

    Attributes:
        unsent: bytes that the kernel was given and has not sent yet.
        round_trip_s: smallest of a packet; None where the kernel does not report it.
        trip_s: that of now, smoothed.
        in_network: bytes in packets that were sent and have neither arrived nor been lost, about.
        rate: bytes a second that the network delivers; None if the connection is not TCP.
    """

    unsent: int = 0
    round_trip_s: float | None = None
    trip_s: float | None = None
    in_network: int = 0
    rate: float | None = None


NOT_TCP = TcpState()
UNMEASURED = (1 << 32) - 1


def tune(connection: socket.socket) -> None:
    """Keep the kernel's queue short; options that the kernel does not know are skipped."""
    if connection.family == socket.AF_UNIX:
        return
    wanted: list[tuple[int, int | bytes]] = [
        (socket.TCP_NODELAY, 1),
        (socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES),
        (socket.TCP_CONGESTION, CALM),
    ]
    for option, value in wanted:
        try:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
        except OSError:
            continue


def tcp_state(connection: Socket) -> TcpState:
    """State of a connection; the default one if it is not TCP."""
    info = _option(connection, socket.TCP_INFO, INFO.size)
    if len(info) < INFO.size:
        return NOT_TCP
    size, unacked, arrived, lost, again, rtt_us, unsent, min_rtt_us, rate = INFO.unpack(info)
    in_network = size * max(unacked - arrived - lost + again, 0)
    bbr = _bbr(connection)
    if bbr is not None:
        rate, min_rtt_us = bbr
    round_trip_s = min_rtt_us / 1e6 if 0 < min_rtt_us < UNMEASURED else None
    return TcpState(unsent, round_trip_s, rtt_us / 1e6 or None, in_network, float(rate))


def _bbr(connection: Socket) -> tuple[int, int] | None:
    """Rate and round trip that BBR found; other congestion controls report other things there."""
    name = _option(connection, socket.TCP_CONGESTION, NAME_BYTES)
    if name.rstrip(b"\0") != CALM:
        return None
    info = _option(connection, TCP_CC_INFO, BBR_INFO.size)
    if len(info) < BBR_INFO.size:
        return None
    rate, min_rtt_us = BBR_INFO.unpack(info)
    return (rate, min_rtt_us) if rate else None


def _option(connection: Socket, name: int, size: int) -> bytes:
    if connection.family == socket.AF_UNIX:
        return b""
    try:
        return connection.getsockopt(socket.IPPROTO_TCP, name, size)
    except OSError:
        return b""
