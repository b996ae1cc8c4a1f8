"""Changes that a client reports to its readers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.messages import (
    EventMessage,
    FanMessage,
    ImageMessage,
    LocalizationMessage,
    MapInfo,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
)

__all__ = ["ClientChange", "ConnectionStatus", "LinkChanged", "MapChanged", "MapReset"]

LinkState = Literal["connecting", "connected", "waiting", "closed"]


@dataclass(frozen=True, slots=True)
class ConnectionStatus:
    """State of the connection.

    Attributes:
        state: `waiting` is between attempts.
        address: of the daemon.
        reason: of the state, for a person.
        since_s: monotonic time when the state began.
        connects: number of connections so far.
        bytes: received since the first connection.
        faults: connections that ended because the daemon broke the protocol.
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
    """The state of the connection changed."""

    link: ConnectionStatus


@dataclass(frozen=True, slots=True)
class MapReset:
    """The mirror is empty and begins again, perhaps with another map."""

    info: MapInfo


@dataclass(frozen=True, slots=True, eq=False)
class MapChanged:
    """Blocks of the mirror changed.

    Attributes:
        keys: (N, 3) int32, of the blocks; blocks that are no longer in the mirror are empty.
        stamp_ns: Unix time of this state of the map.
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
