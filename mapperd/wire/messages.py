"""What a client and the daemon say to each other on the map stream: docs/map-stream.md.

Each message is one MessagePack map whose key `t` names its kind; times are Unix nanoseconds,
lengths metres, angles radians, arrays bytes in little endian.
"""

from mapperd.wire.client_messages import (
    Ack,
    Ask,
    Change,
    Hello,
    Resume,
)
from mapperd.wire.protocol import (
    BLOCK_EDGE,
    MAX_BLOCKS,
    MAX_FROM_CLIENT,
    MAX_FROM_SERVER,
    MAX_LEVEL,
    MAX_PATH,
    MAX_SETTINGS,
    VERSION,
    WANTS,
    Box,
    Interest,
    Vector,
    Want,
)
from mapperd.wire.server_messages import (
    Answer,
    Blocks,
    Bye,
    Event,
    Fan,
    Greeting,
    Image,
    Localization,
    MapFacts,
    Path,
    Pose,
    Reset,
    Returns,
    Robots,
    Settings,
    Status,
    Welcome,
)

__all__ = [
    "BLOCK_EDGE",
    "MAX_BLOCKS",
    "MAX_FROM_CLIENT",
    "MAX_FROM_SERVER",
    "MAX_LEVEL",
    "MAX_PATH",
    "MAX_SETTINGS",
    "VERSION",
    "WANTS",
    "Ack",
    "Answer",
    "Ask",
    "Blocks",
    "Box",
    "Bye",
    "Change",
    "Event",
    "Fan",
    "FromClient",
    "FromServer",
    "Greeting",
    "Hello",
    "Image",
    "Interest",
    "Localization",
    "MapFacts",
    "Path",
    "Pose",
    "Reset",
    "Resume",
    "Returns",
    "Robots",
    "Settings",
    "Status",
    "Vector",
    "Want",
    "Welcome",
]

FromClient = Hello | Change | Ack | Ask
FromServer = (
    Greeting
    | Welcome
    | Blocks
    | Reset
    | Pose
    | Path
    | Fan
    | Returns
    | Image
    | Robots
    | Localization
    | Status
    | Event
    | Settings
    | Answer
    | Bye
)
