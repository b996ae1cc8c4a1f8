"""Socket options of TCP, and the state that the kernel reports about a connection."""

import socket
import struct
from dataclasses import dataclass
from typing import Protocol

__all__ = ["Socket", "TcpState", "tcp_state", "tune"]

UNSENT_BYTES = 16384
"""Bytes that the kernel takes beyond what is on the wire: more would only become old there."""

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


UNKNOWN = TcpState()
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
        return UNKNOWN
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
