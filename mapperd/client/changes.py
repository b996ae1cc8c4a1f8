"""What a client is sent, in the order in which it happened."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.messages import (
    EventMessage,
    FanMessage,
    ImageMessage,
    LocalizationMessage,
    MapFacts,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
)

__all__ = ["ClientChange", "LinkChanged", "LinkStatus", "MapChanged", "MapReset"]

LinkState = Literal["connecting", "connected", "waiting", "closed"]


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """How the connection is.

    Attributes:
        state: `waiting` is between attempts.
        address: of the daemon.
        reason: of the state, for a person.
        since_s: monotonic, when it became so.
        connects: how often it was connected.
        bytes: received since the first connection.
        faults: connections that ended because the daemon said what it may not.
    """

    state: LinkState
    address: str
    reason: str
    since_s: float
    connects: int = 0
    bytes: int = 0
    faults: int = 0


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The connection came, or went."""

    link: LinkStatus


@dataclass(frozen=True, slots=True)
class MapReset:
    """The map is another one, or held again: all that was known of it is forgotten."""

    facts: MapFacts


@dataclass(frozen=True, slots=True, eq=False)
class MapChanged:
    """Blocks of the mirror are others than before.

    Attributes:
        keys: (N, 3) int32, of the blocks; those that are not in the mirror any more are empty.
        stamp_ns: when the map was so, Unix.
        left: blocks that are still to come.
    """

    keys: NDArray[np.int32]
    stamp_ns: int
    left: int


ClientChange = (
    LinkChanged
    | MapReset
    | MapChanged
    | PoseMessage
    | PathMessage
    | FanMessage
    | ReturnsMessage
    | ImageMessage
    | RobotsMessage
    | LocalizationMessage
    | StatusMessage
    | EventMessage
    | SettingsMessage
)
