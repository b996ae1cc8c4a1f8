"""Driver for Blueprint Subsea Oculus multibeam imaging sonars. It can be used alone.

Names that need asyncio are imported on first use, so that importing this package is fast.
"""

import importlib
from typing import TYPE_CHECKING, Final

from oculus_driver.clock import PingTime, SonarClock, row_times_ns
from oculus_driver.discovery.diagnosis import (
    Finding,
    bind_finding,
    connection_finding,
    discovery_findings,
    silence_finding,
    status_findings,
    subnet_finding,
)
from oculus_driver.discovery.state import DiscoveredSonar, DiscoveryState
from oculus_driver.encode import (
    bearing_table_cdeg,
    encode_dummy,
    encode_fire,
    encode_ping,
    encode_status,
    encode_user_config,
)
from oculus_driver.errors import (
    DiscoveryError,
    EncodeError,
    LinkError,
    OculusError,
    OutsideLimitsError,
    ProtocolError,
    RecordingError,
    Reject,
    SettingsError,
)
from oculus_driver.full_ping import FullPing, decode_full_ping
from oculus_driver.link.confirmation import Confirmation, Difference
from oculus_driver.link.state import LinkState, LinkStatus, LinkTimeouts, SonarCounters
from oculus_driver.models import Model, model_of
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.settings import FireSettings, Mode
from oculus_driver.sound_speed import (
    pressure_bar_at,
    speed_of_sound_at_depth_mps,
    speed_of_sound_mps,
)
from oculus_driver.status import Status, decode_status
from oculus_driver.stream import Message, StreamCounters, StreamParser
from oculus_driver.wire import PingRate

if TYPE_CHECKING:
    from oculus_driver.discovery.listener import Discovery, DiscoveryUpdates, addresses_towards
    from oculus_driver.link.ping_queue import PingQueue
    from oculus_driver.sonar import OculusSonar
    from oculus_driver.virtual_sonar.device import Identity
    from oculus_driver.virtual_sonar.faults import Faults
    from oculus_driver.virtual_sonar.playback import PlaybackSonar
    from oculus_driver.virtual_sonar.server import VirtualSonarCounters

__all__ = [
    "Confirmation",
    "Difference",
    "DiscoveredSonar",
    "Discovery",
    "DiscoveryError",
    "DiscoveryState",
    "DiscoveryUpdates",
    "EncodeError",
    "Faults",
    "Finding",
    "FireSettings",
    "FullPing",
    "Identity",
    "LinkError",
    "LinkState",
    "LinkStatus",
    "LinkTimeouts",
    "Message",
    "Mode",
    "Model",
    "OculusError",
    "OculusSonar",
    "OutsideLimitsError",
    "Ping",
    "PingQueue",
    "PingRate",
    "PingSequence",
    "PingTime",
    "PlaybackSonar",
    "ProtocolError",
    "RecordingError",
    "Reject",
    "SettingsError",
    "SonarClock",
    "SonarCounters",
    "Status",
    "StreamCounters",
    "StreamParser",
    "VirtualSonarCounters",
    "__version__",
    "addresses_towards",
    "bearing_table_cdeg",
    "bind_finding",
    "connection_finding",
    "decode_full_ping",
    "decode_ping",
    "decode_status",
    "discovery_findings",
    "encode_dummy",
    "encode_fire",
    "encode_ping",
    "encode_status",
    "encode_user_config",
    "model_of",
    "pressure_bar_at",
    "row_times_ns",
    "silence_finding",
    "speed_of_sound_at_depth_mps",
    "speed_of_sound_mps",
    "status_findings",
    "subnet_finding",
]

__version__ = "0.2.0"


# Modules that need asyncio, or import one that does.
_LAZY: Final = {
    "Discovery": lambda: importlib.import_module("oculus_driver.discovery.listener"),
    "Faults": lambda: importlib.import_module("oculus_driver.virtual_sonar.faults"),
    "Identity": lambda: importlib.import_module("oculus_driver.virtual_sonar.device"),
    "OculusSonar": lambda: importlib.import_module("oculus_driver.sonar"),
    "PingQueue": lambda: importlib.import_module("oculus_driver.link.ping_queue"),
    "VirtualSonarCounters": lambda: importlib.import_module("oculus_driver.virtual_sonar.server"),
    "PlaybackSonar": lambda: importlib.import_module("oculus_driver.virtual_sonar.playback"),
    "DiscoveryUpdates": lambda: importlib.import_module("oculus_driver.discovery.listener"),
    "addresses_towards": lambda: importlib.import_module("oculus_driver.discovery.listener"),
}


def __getattr__(name: str) -> object:
    if name in _LAZY:
        return getattr(_LAZY[name](), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
