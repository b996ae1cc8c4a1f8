"""Common behaviour of virtual sonars: identity, requests of clients, statuses."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from oculus_driver.encode import encode_status, encode_user_config
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
class FireRequest:
    """A received fire message; fields as in `oculus_driver.wire`."""

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
        """Whether it requests standby."""
        return self.ping_rate == PingRate.STANDBY

    @property
    def triggered(self) -> bool:
        """Whether it requests one ping per fire message."""
        return bool(self.flags & FireFlags.NETWORK_TRIGGER)


@dataclass(frozen=True, slots=True)
class ConfigRequest:
    """A user configuration message; without an address it is a query."""

    address: IPv4Address
    netmask: IPv4Address
    dhcp: bool

    @property
    def is_query(self) -> bool:
        """Whether the present configuration is queried."""
        return not int(self.address)


Command = FireRequest | ConfigRequest


class CommandReader:
    """Splits the bytes of one client into commands. Never raises; buffers at most one command.

    Attributes:
        ignored_bytes: bytes outside commands.
    """

    def __init__(self) -> None:
        self.ignored_bytes = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that these bytes complete, without dummies."""
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
    """Return the size of a command. Some programs leave the payload size at 0."""
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
        return ConfigRequest(
            IPv4Address(fields["address"]), IPv4Address(fields["netmask"]), bool(fields["dhcp"])
        )
    return None


def _fire(data: bytes) -> FireRequest | None:
    version_2 = HEADER.unpack(data)["version"] == _VERSION_2
    layout = FIRE_V2 if version_2 else FIRE_V1
    if len(data) < layout.size:
        return None
    fields = layout.unpack(data)
    return FireRequest(
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


RUNNING: Final = 0x03
"""Status bits of a sonar in order: its main application is running."""

DATA_PORT_IN_USE: Final = 1 << 7

LOCAL: Final = IPv4Address("127.0.0.1")
LOCAL_MASK: Final = IPv4Address("255.0.0.0")
M750D_PART: Final = 1032
_MASTER_STATE: Final = 0b111
_SHUT_DOWN: Final = 0b11 << 14


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of the sonar; None: from the recording.

    Attributes:
        device_id: serial number.
        part_number: see `oculus_driver.models`; M750d if the recording has none.
        address, netmask: as in statuses.
    """

    device_id: int | None = None
    part_number: int | None = None
    address: IPv4Address = LOCAL
    netmask: IPv4Address = LOCAL_MASK


class VirtualDevice:
    """Processes fire messages and reports a status. No sockets, no clock.

    Args:
        identity: of the sonar.
        device_id: serial number.
        part_number: of the model.
        ignored_fire_version: version of fire messages to ignore.

    Attributes:
        request: the last accepted fire message, or None.
        status_bits: as in statuses; set them to simulate overheating or a halted boot loader.
        temperature_c, pressure_bar: as in statuses.
        fires: accepted fire messages.
        fires_ignored: ignored fire messages.
        triggers: number of fire messages without a ping yet, in triggered mode.
    """

    def __init__(
        self, identity: Identity, device_id: int, part_number: int, ignored_fire_version: int | None
    ) -> None:
        self.identity = identity
        self.request: FireRequest | None = None
        self.status_bits = RUNNING
        self.temperature_c = 20.0
        self.pressure_bar = 1.0
        self.fires = 0
        self.fires_ignored = 0
        self.triggers = 0
        self._device_id = device_id
        self._part_number = part_number
        self._ignored_fire_version = ignored_fire_version

    @property
    def source_id(self) -> int:
        """Source id in the headers of its own messages."""
        return self._device_id & 0xFFFF

    @property
    def part_number(self) -> int:
        """Part number, see `oculus_driver.models`."""
        return self._part_number

    @property
    def can_ping(self) -> bool:
        """Whether its status bits allow pings."""
        halted = self.status_bits & _MASTER_STATE != RUNNING
        return not halted and self.status_bits & _SHUT_DOWN != _SHUT_DOWN

    @property
    def triggered(self) -> bool:
        """Whether each ping needs its own fire message."""
        return self.request is not None and self.request.triggered

    def receive(self, reader: CommandReader, data: bytes) -> list[bytes]:
        """Process bytes of a client and return the replies."""
        return [reply for command in reader.feed(data) if (reply := self._apply(command))]

    def status(self, client: IPv4Address | None) -> bytes:
        """Return a status datagram; `client` is the connected client."""
        return encode_status(
            device_id=self._device_id,
            part_number=self._part_number,
            status_bits=self.status_bits | (DATA_PORT_IN_USE if client else 0),
            address=self.identity.address,
            netmask=self.identity.netmask,
            client_address=client,
            temperatures_c=(self.temperature_c,) * 8,
            pressure_bar=self.pressure_bar,
        )

    def _apply(self, command: Command) -> bytes | None:
        if isinstance(command, ConfigRequest):
            return self._configuration() if command.is_query else None
        if command.version == self._ignored_fire_version:
            self.fires_ignored += 1
            return None
        self.fires += 1
        self.request = command
        self.triggers = self.triggers + 1 if command.triggered else 0
        return None

    def _configuration(self) -> bytes:
        who = self.identity
        return encode_user_config(
            address=who.address, netmask=who.netmask, source_id=self.source_id
        )
