"""A driver of Blueprint Subsea Oculus multibeam imaging sonars, useful alone."""

from oculus_driver.confirmation import Confirmation, Difference
from oculus_driver.encode import (
    bearing_table_cdeg,
    encode_dummy,
    encode_fire,
    encode_ping,
    encode_status,
    encode_user_config,
)
from oculus_driver.errors import (
    EncodeError,
    LinkError,
    OculusError,
    ProtocolError,
    RecordingError,
    SettingsError,
)
from oculus_driver.link_state import LinkState, LinkStatus, LinkTimes
from oculus_driver.models import Model, model_of
from oculus_driver.ping import Ping, Reject, decode_ping
from oculus_driver.ping_queue import PingQueue
from oculus_driver.sequence import PingSequence
from oculus_driver.settings import FireSettings, Mode
from oculus_driver.sonar import OculusSonar
from oculus_driver.sonar_counters import SonarCounters
from oculus_driver.status import Status, decode_status
from oculus_driver.stream import Message, StreamCounters, StreamParser
from oculus_driver.wire import PingRate

__all__ = [
    "Confirmation",
    "Difference",
    "EncodeError",
    "FireSettings",
    "LinkError",
    "LinkState",
    "LinkStatus",
    "LinkTimes",
    "Message",
    "Mode",
    "Model",
    "OculusError",
    "OculusSonar",
    "Ping",
    "PingQueue",
    "PingRate",
    "PingSequence",
    "ProtocolError",
    "RecordingError",
    "Reject",
    "SettingsError",
    "SonarCounters",
    "Status",
    "StreamCounters",
    "StreamParser",
    "bearing_table_cdeg",
    "decode_ping",
    "decode_status",
    "encode_dummy",
    "encode_fire",
    "encode_ping",
    "encode_status",
    "encode_user_config",
    "model_of",
]
