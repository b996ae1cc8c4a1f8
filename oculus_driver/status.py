"""Status datagrams: identity, addresses and condition of a sonar; overheating protection."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Final

from oculus_driver.errors import Reject
from oculus_driver.models import Model, model_of
from oculus_driver.wire import MAGIC, STATUS

if TYPE_CHECKING:
    from oculus_driver.ping import Ping, PingHeader

_TEMPERATURE_LIMITS_C: Final = (-40.0, 120.0)
_PRESSURE_LIMITS_BAR: Final = (-5.0, 1000.0)

MASTER_STATES: Final = ("boot loader booting", "boot loader halted", "booting", "running")
PAUSE_REASONS: Final = (
    "magnetic switch",
    "boot from main",
    "flash error",
    "JTAG load",
    "firmware error",
    "compatibility error",
    "brown-out",
    "undefined",
)
TEMPERATURE_STATES: Final = ("good", "high", "reserved", "shut down")

MAIN_TEMPERATURE: Final = 6
"""Index of the sensor that other drivers use as the temperature, of eight."""

HYSTERESIS_C: Final = 3.0
"""A hot sonar may ping again this far below the limit."""


@dataclass(frozen=True, slots=True)
class Status:
    """One status datagram.

    Attributes:
        device_id: serial number.
        model: from the part number; an unknown part number gives a model, too.
        status_bits: raw.
        address, netmask: of the sonar.
        client_address: the connected client, None without one.
        mac: six bytes.
        firmware: versions of ARM 0, ARM 1 and FPGA, raw.
        temperatures_c: eight internal temperatures; None = not available.
        pressure_bar: None = not available.
        datagram: the bytes as received.
    """

    device_id: int
    model: Model
    status_bits: int
    address: IPv4Address
    netmask: IPv4Address
    client_address: IPv4Address | None
    mac: bytes
    firmware: tuple[int, int, int]
    temperatures_c: tuple[float | None, ...]
    pressure_bar: float | None
    datagram: bytes = field(default=b"", repr=False, compare=False)

    @property
    def source_id(self) -> int:
        """Source id in the headers of this sonar's messages."""
        return self.device_id & 0xFFFF

    @property
    def master_state(self) -> str:
        """One of `MASTER_STATES`, or "unknown"."""
        state = self.status_bits & 0b111
        return MASTER_STATES[state] if state < len(MASTER_STATES) else "unknown"

    @property
    def pause_reason(self) -> str | None:
        """Why the sonar is halted in its boot loader, None if it is not."""
        if self.status_bits & 0b111 > 1:
            return None
        return PAUSE_REASONS[self.status_bits >> 3 & 0b111]

    @property
    def busy(self) -> bool:
        """Whether a client uses the data port."""
        return bool(self.status_bits & 1 << 7) or self.client_address is not None

    @property
    def temperature_state(self) -> str:
        """One of `TEMPERATURE_STATES`; in state "shut down" the sonar has stopped pinging."""
        return TEMPERATURE_STATES[self.status_bits >> 14 & 0b11]

    @property
    def transmitter_failed(self) -> bool:
        """Whether the transmit circuit has failed."""
        return bool(self.status_bits & 1 << 16)


def decode_status(datagram: bytes) -> Status | Reject:
    """Return the status in a datagram of at least 142 bytes; further bytes are ignored."""
    if len(datagram) < STATUS.size:
        return Reject("short_message", f"{len(datagram)} bytes, a status has {STATUS.size}", 0)
    fields = STATUS.unpack(datagram)
    if fields["magic"] != MAGIC:
        return Reject("bad_magic", f"starts with {datagram[:2].hex()}", 0)
    client = IPv4Address(fields["client_address"])
    return Status(
        device_id=fields["device_id"],
        model=model_of(fields["device_part_number"]),
        status_bits=fields["status_bits"],
        address=IPv4Address(fields["address"]),
        netmask=IPv4Address(fields["netmask"]),
        client_address=client if int(client) else None,
        mac=fields["mac"],
        firmware=(fields["arm0_version"], fields["arm1_version"], fields["fpga_version"]),
        temperatures_c=tuple(
            _available(t, _TEMPERATURE_LIMITS_C) for t in fields["temperatures_c"]
        ),
        pressure_bar=_available(fields["pressure_bar"], _PRESSURE_LIMITS_BAR),
        datagram=datagram,
    )


def _available(value: float, limits: tuple[float, float]) -> float | None:
    return value if math.isfinite(value) and limits[0] <= value <= limits[1] else None


class ThermalGuard:
    """Decides whether the sonar is too hot to ping, by its own status and an optional limit.

    Out of the water a sonar heats up within minutes.

    In standby there are no pings: only the status shows that the sonar has cooled down.

    Args:
        limit_c: maximum temperature while pinging, of the water (pings) or of the sonar (status).
            None: only the sonar's own limit.

    Attributes:
        reason: human-readable, None while the sonar may ping.
    """

    def __init__(self, limit_c: float | None) -> None:
        self.reason: str | None = None
        self._limit_c = limit_c

    def ping(self, ping: Ping | PingHeader) -> None:
        """Update with the temperature of a ping, if it has one."""
        self._reading(ping.temperature_c)

    def status(self, status: Status) -> None:
        """Update with a status."""
        if status.temperature_state == "shut down":
            self.reason = "the sonar is too hot and has stopped pinging: is it under water?"
        elif self._limit_c is None:
            self.reason = None
        else:
            self._reading(status.temperatures_c[MAIN_TEMPERATURE])

    def _reading(self, temperature_c: float | None) -> None:
        if temperature_c is None or self._limit_c is None:
            return
        if temperature_c >= self._limit_c:
            limit = f"the limit is {self._limit_c:g}"
            self.reason = f"{temperature_c:.1f} °C, {limit}: is the sonar under water?"
        elif temperature_c <= self._limit_c - HYSTERESIS_C:
            self.reason = None
