"""Clients of a daemon: mirror its live map, follow its state, send it requests.

docs/reference/map-stream.md has an example and the protocol.
"""

from mapperd.client.changes import ClientChange, ConnectionStatus, LinkChanged, MapChanged, MapReset
from mapperd.client.client import MapClient
from mapperd.client.errors import AskError, EndedError
from mapperd.client.follower import MapFollower
from mapperd.client.mirror import Cells, MapMirror
from mapperd.wire import messages
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import Interest, MapFacts, Want

__all__ = [
    "AskError",
    "Box",
    "Cells",
    "ClientChange",
    "ConnectionStatus",
    "EndedError",
    "Event",
    "Fan",
    "Image",
    "Interest",
    "LinkChanged",
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

Event = messages.EventMessage
Fan = messages.FanMessage
Image = messages.ImageMessage
Localization = messages.LocalizationMessage
Box = messages.MapBox
Path = messages.PathMessage
Pose = messages.PoseMessage
Returns = messages.ReturnsMessage
Robots = messages.RobotsMessage
Settings = messages.SettingsMessage
Status = messages.StatusMessage
Welcome = messages.WelcomeMessage
