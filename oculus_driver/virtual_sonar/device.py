"""What every pretended sonar has in common: who it is, what it was told, what it says of itself."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from oculus_driver.encode import encode_status, encode_user_config
from oculus_driver.virtual_sonar.commands import Command, CommandReader, ConfigDemand, FireDemand

RUNNING: Final = 0x03
"""Status bits of a sonar that is well: its main application runs."""

DATA_PORT_IN_USE: Final = 1 << 7

LOCAL: Final = IPv4Address("127.0.0.1")
LOCAL_MASK: Final = IPv4Address("255.0.0.0")
M750D_PART: Final = 1032
_MASTER_STATE: Final = 0b111
_SHUT_DOWN: Final = 0b11 << 14


@dataclass(frozen=True, slots=True)
class Identity:
    """Who the sonar says it is; None takes it from the recording.

    Attributes:
        device_id: serial number.
        part_number: see `oculus_driver.models`; M750d where the recording does not know either.
        address, netmask: told in statuses.
    """

    device_id: int | None = None
    part_number: int | None = None
    address: IPv4Address = LOCAL
    netmask: IPv4Address = LOCAL_MASK


class ObedientDevice:
    """Hears fire messages and says who it is. No sockets, no clock.

    Args:
        identity: of the sonar, complete.
        deaf_to_version: version of fire messages that are not understood.

    Attributes:
        demand: the last fire message obeyed, or None.
        status_bits: as in statuses; change them to overheat the sonar or halt it.
        temperature_c, pressure_bar: told in statuses.
        fires: fire messages obeyed.
        fires_ignored: fire messages not understood.
        triggers: fire messages that have not had their ping yet, in triggered mode.
    """

    def __init__(
        self, identity: Identity, device_id: int, part_number: int, deaf_to_version: int | None
    ) -> None:
        self.identity = identity
        self.demand: FireDemand | None = None
        self.status_bits = RUNNING
        self.temperature_c = 20.0
        self.pressure_bar = 1.0
        self.fires = 0
        self.fires_ignored = 0
        self.triggers = 0
        self._device_id = device_id
        self._part_number = part_number
        self._deaf_to_version = deaf_to_version

    @property
    def source_id(self) -> int:
        """What the headers of its own messages carry."""
        return self._device_id & 0xFFFF

    @property
    def part_number(self) -> int:
        """Which model it is, see `oculus_driver.models`."""
        return self._part_number

    @property
    def able(self) -> bool:
        """Whether its status bits allow it to ping."""
        halted = self.status_bits & _MASTER_STATE != RUNNING
        return not halted and self.status_bits & _SHUT_DOWN != _SHUT_DOWN

    @property
    def triggered(self) -> bool:
        """Whether each ping needs a fire message of its own."""
        return self.demand is not None and self.demand.triggered

    def hear(self, reader: CommandReader, data: bytes) -> list[bytes]:
        """Take bytes of a client and return the messages that answer them."""
        return [reply for command in reader.feed(data) if (reply := self._obey(command))]

    def status(self, client: IPv4Address | None) -> bytes:
        """Return a status datagram; `client` is who holds the data port."""
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

    def _obey(self, command: Command) -> bytes | None:
        if isinstance(command, ConfigDemand):
            return self._configuration() if command.asks else None
        if command.version == self._deaf_to_version:
            self.fires_ignored += 1
            return None
        self.fires += 1
        self.demand = command
        self.triggers = self.triggers + 1 if command.triggered else 0
        return None

    def _configuration(self) -> bytes:
        who = self.identity
        return encode_user_config(
            address=who.address, netmask=who.netmask, source_id=self.source_id
        )
