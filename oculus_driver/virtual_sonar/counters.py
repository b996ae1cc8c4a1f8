"""What a played sonar has done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class PlayCounters:
    """What a played sonar has done.

    Attributes:
        clients: connections served; refused: closed at once.
        pings: sent whole; pings_damaged: flipped, cut or lost on purpose.
        other_messages: dummies, answers and whatever else was recorded.
        bytes_sent: of the data port.
        stalls, restarts, cuts: that happened.
        statuses: datagrams sent; statuses_unsent: refused by the network.
    """

    clients: int = 0
    refused: int = 0
    pings: int = 0
    pings_damaged: int = 0
    other_messages: int = 0
    bytes_sent: int = 0
    stalls: int = 0
    restarts: int = 0
    cuts: int = 0
    statuses: int = 0
    statuses_unsent: int = 0
