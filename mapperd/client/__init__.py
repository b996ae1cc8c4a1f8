"""Clients of a daemon: mirror its live map, follow its state, send it requests.

docs/reference/map-stream.md has an example and the protocol.
"""

from mapperd.client.changes import ClientChange, ConnectionStatus, LinkChanged, MapChanged, MapReset
from mapperd.client.client import MapClient
from mapperd.client.follower import MapFollower
from mapperd.client.mirror import Cells, MapMirror
from mapperd.client.validation import AskError, EndedError
from mapperd.wire import messages
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import (
    EventMessage,
    FanMessage,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapBox,
    MapInfo,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    Want,
    WelcomeMessage,
)

__all__ = [
    "AskError",
    "Cells",
    "ClientChange",
    "ConnectionStatus",
    "EndedError",
    "EventMessage",
    "FanMessage",
    "ImageMessage",
    "Interest",
    "LinkChanged",
    "LocalizationMessage",
    "MapBox",
    "MapChanged",
    "MapClient",
    "MapFollower",
    "MapInfo",
    "MapMirror",
    "MapReset",
    "PathMessage",
    "PoseMessage",
    "ReturnsMessage",
    "RobotsMessage",
    "SettingsMessage",
    "StatusMessage",
    "StreamError",
    "Want",
    "WelcomeMessage",
]

_FORMER_NAMES = {
    "Box": "MapBox",
    "Event": "EventMessage",
    "Fan": "FanMessage",
    "Image": "ImageMessage",
    "Localization": "LocalizationMessage",
    "Path": "PathMessage",
    "MapFacts": "MapInfo",
    "Pose": "PoseMessage",
    "Returns": "ReturnsMessage",
    "Robots": "RobotsMessage",
    "Settings": "SettingsMessage",
    "Status": "StatusMessage",
    "Welcome": "WelcomeMessage",
}
"""Names of version 0.2.0 that programs may still import, by what they are called now."""


def __getattr__(name: str) -> object:
    if name not in _FORMER_NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(messages, _FORMER_NAMES[name])
