"""One packet of a network capture, and what is believed about its size."""

from __future__ import annotations

from typing import Final, NamedTuple

MAX_PACKET: Final = 1 << 20
NS_PER_S: Final = 1_000_000_000


class Packet(NamedTuple):
    """One captured packet.

    Attributes:
        arrival_ns: when it was captured, nanoseconds since 1970; None where not recorded.
        link_type: how its first header is to be read, a number of the tcpdump.org list.
        data: its bytes, perhaps not all.
    """

    arrival_ns: int | None
    link_type: int
    data: bytes
