"""What the system's TCP is told about a connection, and tells about it."""

import socket
import struct
from dataclasses import dataclass
from typing import Protocol

__all__ = ["Socket", "TcpState", "fills_buffers", "tcp_state", "tune"]

UNSENT_BYTES = 16384
"""That the kernel takes beyond what is on the wire: more would only become old there."""

CALM = b"bbr"
"""The congestion control that does not fill the network's buffers."""

NAME_BYTES = 16

STATE = struct.Struct("<16xI4xIIII28xI72xI")
"""Of Linux's `struct tcp_info`: tcpi_snd_mss; packets in tcpi_unacked, of which tcpi_sacked have
arrived and tcpi_lost have not, and tcpi_retrans that were sent again; tcpi_rtt in microseconds; and
tcpi_notsent_bytes."""

TCP_CC_INFO = 26
BBR_INFO = struct.Struct("<Q")
"""The beginning of Linux's `struct tcp_bbr_info`: the rate that it found, in bytes a second."""


class Socket(Protocol):
    """As much of a socket as is needed; asyncio's are not whole ones."""

    @property
    def family(self) -> int:
        """Of its addresses."""

    def getsockopt(self, level: int, name: int, size: int, /) -> bytes:
        """An option as bytes."""


@dataclass(frozen=True, slots=True)
class TcpState:
    """How a connection stands.

    Attributes:
        unsent: bytes that the system was given and has not sent yet.
        round_trip_s: of packets, of late; None where the system does not say.
        in_network: bytes in packets that were sent and have neither arrived nor been lost, about;
            None where it does not say.
        rate: bytes a second that the network delivers, losses and what waits for them apart; None
            where it does not say.
    """

    unsent: int = 0
    round_trip_s: float | None = None
    in_network: int | None = None
    rate: float | None = None


UNKNOWN = TcpState()


def tune(connection: socket.socket) -> None:
    """Keep what lies in the kernel short; what the system does not know is left out."""
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


def fills_buffers(connection: Socket) -> bool:
    """Whether its congestion control sends until the network's buffers are full."""
    said = _option(connection, socket.TCP_CONGESTION, NAME_BYTES)
    return bool(said) and said.rstrip(b"\0") != CALM


def tcp_state(connection: Socket) -> TcpState:
    """How a connection stands; no TCP connection has neither."""
    said = _option(connection, socket.TCP_INFO, STATE.size)
    if len(said) < STATE.size:
        return UNKNOWN
    size, unacked, arrived, lost, again, round_trip_us, unsent = STATE.unpack(said)
    in_network = size * max(unacked - arrived - lost + again, 0)
    return TcpState(unsent, round_trip_us / 1e6 or None, in_network, _rate(connection))


def _rate(connection: Socket) -> float | None:
    """What BBR knows; other congestion controls say other things in its place."""
    name = _option(connection, socket.TCP_CONGESTION, NAME_BYTES)
    if name.rstrip(b"\0") != CALM:
        return None
    said = _option(connection, TCP_CC_INFO, BBR_INFO.size)
    return None if len(said) < BBR_INFO.size else float(BBR_INFO.unpack(said)[0]) or None


def _option(connection: Socket, name: int, size: int) -> bytes:
    if connection.family == socket.AF_UNIX:
        return b""
    try:
        return connection.getsockopt(socket.IPPROTO_TCP, name, size)
    except OSError:
        return b""
