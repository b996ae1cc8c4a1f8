"""A driver of Blueprint Subsea Oculus multibeam imaging sonars, useful alone."""

from oculus_driver.encode import (
    bearing_table_cdeg,
    encode_dummy,
    encode_fire,
    encode_ping,
    encode_status,
    encode_user_config,
)
from oculus_driver.errors import EncodeError, OculusError, ProtocolError, RecordingError
from oculus_driver.models import Model, model_of
from oculus_driver.ping import Ping, Reject, decode_ping
from oculus_driver.play import Faults, Identity, PlayCounters, PlayedSonar
from oculus_driver.sequence import PingSequence
from oculus_driver.status import Status, decode_status
from oculus_driver.stream import Message, StreamCounters, StreamParser

__all__ = [
    "EncodeError",
    "Faults",
    "Identity",
    "Message",
    "Model",
    "OculusError",
    "Ping",
    "PingSequence",
    "PlayCounters",
    "PlayedSonar",
    "ProtocolError",
    "RecordingError",
    "Reject",
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
