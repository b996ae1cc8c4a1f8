"""The live map of a daemon, mirrored: watch it grow, ask it, or steer the daemon.

docs/reference/map-stream.md has an example, and the protocol.
"""

from mapperd.client.changes import ClientChange, LinkChanged, LinkStatus, MapChanged, MapReset
from mapperd.client.client import MapClient
from mapperd.client.errors import AskError, EndedError
from mapperd.client.follower import MapFollower
from mapperd.client.mirror import Cells, MapMirror
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import (
    Box,
    Event,
    Fan,
    Image,
    Interest,
    Localization,
    MapFacts,
    Path,
    Pose,
    Returns,
    Robots,
    Settings,
    Status,
    Want,
    Welcome,
)

__all__ = [
    "AskError",
    "Box",
    "Cells",
    "ClientChange",
    "EndedError",
    "Event",
    "Fan",
    "Image",
    "Interest",
    "LinkChanged",
    "LinkStatus",
    "Localization",
    "MapChanged",
    "MapClient",
    "MapFacts",
    "MapFollower",
    "MapMirror",
    "MapReset",
    "Path",
    "Pose",
    "Returns",
    "Robots",
    "Settings",
    "Status",
    "StreamError",
    "Want",
    "Welcome",
]
