"""What a client says to a sonar, read the way a sonar reads it."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from oculus_driver.wire import (
    DUMMY,
    FIRE_V1,
    FIRE_V2,
    HEADER,
    MAGIC_BYTES,
    USER_CONFIG,
    FireFlags,
    MessageId,
    PingRate,
)

MAX_COMMAND: Final = 4096
_KNOWN: Final = (MessageId.FIRE, MessageId.USER_CONFIG, MessageId.DUMMY)
_VERSION_2: Final = 2


@dataclass(frozen=True, slots=True)
class FireDemand:
    """A fire message as it was received; field by field in `oculus_driver.wire`."""

    version: int = 2
    mode: int = 1
    ping_rate: int = PingRate.NORMAL
    network_speed_mbps: int = 255
    gamma: int = 255
    flags: int = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN
    range_demand: float = 10.0
    gain_percent: float = 50.0
    speed_of_sound_demand_mps: float = 0.0
    salinity_ppt: float = 35.0
    extended_flags: int = 0

    @property
    def standby(self) -> bool:
        """Whether it asks for silence."""
        return self.ping_rate == PingRate.STANDBY

    @property
    def triggered(self) -> bool:
        """Whether it asks for one ping for each fire message."""
        return bool(self.flags & FireFlags.NETWORK_TRIGGER)


@dataclass(frozen=True, slots=True)
class ConfigDemand:
    """A user configuration message: without an address it asks, else it sets."""

    address: IPv4Address
    netmask: IPv4Address
    dhcp: bool

    @property
    def asks(self) -> bool:
        """Whether the present configuration is asked for."""
        return not int(self.address)


Command = FireDemand | ConfigDemand


class CommandReader:
    """Cuts the bytes of one client into commands. Total; holds at most one command.

    Attributes:
        ignored_bytes: bytes that belong to no command.
    """

    def __init__(self) -> None:
        self.ignored_bytes = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that these bytes complete, dummies left out."""
        self._buffer += data
        commands: list[Command] = []
        while len(self._buffer) >= HEADER.size:
            header = HEADER.unpack(self._buffer)
            size = _size(header["message_id"], header["version"], header["payload_size"])
            known = header["message_id"] in _KNOWN and size <= MAX_COMMAND
            if not known or not self._buffer.startswith(MAGIC_BYTES):
                self._resynchronise()
                continue
            if len(self._buffer) < size:
                break
            command = _command(bytes(self._buffer[:size]), header["message_id"])
            del self._buffer[:size]
            if command is not None:
                commands.append(command)
        return commands

    def _resynchronise(self) -> None:
        found = self._buffer.find(MAGIC_BYTES, 1)
        skip = found if found > 0 else len(self._buffer) - 1
        del self._buffer[:skip]
        self.ignored_bytes += skip


def _size(message_id: int, version: int, payload_size: int) -> int:
    """Return the bytes of a command. Some programs leave the payload size of theirs at 0."""
    if payload_size:
        return HEADER.size + payload_size
    if message_id == MessageId.FIRE:
        return FIRE_V2.size if version == _VERSION_2 else FIRE_V1.size
    return USER_CONFIG.size if message_id == MessageId.USER_CONFIG else DUMMY.size


def _command(data: bytes, message_id: int) -> Command | None:
    if message_id == MessageId.FIRE and len(data) >= FIRE_V1.size:
        return _fire(data)
    if message_id == MessageId.USER_CONFIG and len(data) >= USER_CONFIG.size:
        fields = USER_CONFIG.unpack(data)
        return ConfigDemand(
            IPv4Address(fields["address"]), IPv4Address(fields["netmask"]), bool(fields["dhcp"])
        )
    return None


def _fire(data: bytes) -> FireDemand | None:
    version_2 = HEADER.unpack(data)["version"] == _VERSION_2
    layout = FIRE_V2 if version_2 else FIRE_V1
    if len(data) < layout.size:
        return None
    fields = layout.unpack(data)
    return FireDemand(
        version=_VERSION_2 if version_2 else 1,
        mode=fields["mode"],
        ping_rate=fields["ping_rate"],
        network_speed_mbps=fields["network_speed_mbps"],
        gamma=fields["gamma"],
        flags=fields["flags"],
        range_demand=fields["range_demand"],
        gain_percent=fields["gain_percent"],
        speed_of_sound_demand_mps=fields["speed_of_sound_demand_mps"],
        salinity_ppt=fields["salinity_ppt"],
        extended_flags=fields.get("extended_flags", 0),
    )
