"""Which sonars are present: status datagrams in, one `DiscoveredSonar` per sonar out. Pure.

A sonar broadcasts its status about once per second; it is received even in another subnet.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from oculus_driver.errors import Reject
from oculus_driver.status import MAIN_TEMPERATURE, Status, decode_status

if TYPE_CHECKING:
    from collections.abc import Mapping
    from ipaddress import IPv4Address

    from oculus_driver.models import Model

STALE_NS: Final = 2_000_000_000
"""After this time without a status a sonar is stale. The vendor's viewer drops it then."""

GONE_NS: Final = 5_000_000_000
"""After this time without a status a sonar is gone."""

DUPLICATE_NS: Final = 20_000_000
"""The same status within this time is a copy through another network port, not an update."""

MAX_SONARS: Final = 64
"""More than anybody owns; bounds memory against a flood of invented serial numbers."""

SonarKey = tuple[int, int]
"""Part number and serial number identify a sonar."""


@dataclass(frozen=True, slots=True)
class DiscoveredSonar:
    """A sonar and its last status.

    Attributes:
        address: where to connect, dotted: from the status, or the source of the datagram if the
            status has no valid host address.
        status: the newest status.
        model: from the part number; an unknown part number gives a model, too.
        first_seen_ns: arrival of the first status since the sonar was last gone.
        last_seen_ns: arrival of the newest status; both on the host's monotonic clock.
        count: statuses since `first_seen_ns`; 1 means that the sonar has just appeared.
        source_address: source of the newest datagram, None if unknown.
    """

    address: str
    status: Status
    model: Model
    first_seen_ns: int
    last_seen_ns: int
    count: int
    source_address: str | None = None

    @property
    def key(self) -> SonarKey:
        """Part number and serial number."""
        return self.model.part_number, self.status.device_id

    def stale(self, now_ns: int) -> bool:
        """Return whether the last status is old."""
        return now_ns - self.last_seen_ns > STALE_NS

    def gone(self, now_ns: int) -> bool:
        """Return whether the last status is so old that the sonar counts as gone."""
        return now_ns - self.last_seen_ns > GONE_NS

    def matches(self, wanted: str) -> bool:
        """Return whether a serial number, address, model or family selects this sonar."""
        names = (self.model.name, self.model.family.name)
        exact = (self.address, str(self.status.device_id))
        return wanted in exact or wanted.casefold() in (name.casefold() for name in names)

    def snapshot(self) -> dict[str, Any]:
        """Return the content of the status for JSON; None = not available."""
        status = self.status
        return {
            "address": self.address,
            "source_address": self.source_address,
            "netmask": str(status.netmask),
            "mac": status.mac.hex(":"),
            "serial_number": status.device_id,
            "part_number": self.model.part_number,
            "model": self.model.name,
            "family": self.model.family.name,
            "state": status.master_state,
            "pause_reason": status.pause_reason,
            "busy": status.busy,
            "held_by": None if status.client_address is None else str(status.client_address),
            "firmware": dict(
                zip(("arm0", "arm1", "fpga"), map(version_text, status.firmware), strict=True)
            ),
            "temperature_state": status.temperature_state,
            "temperature_c": status.temperatures_c[MAIN_TEMPERATURE],
            "temperatures_c": list(status.temperatures_c),
            "pressure_bar": status.pressure_bar,
            "transmitter_failed": status.transmitter_failed,
            "status_bits": status.status_bits,
            "count": self.count,
        }


def version_text(raw: int) -> str:
    """Return a firmware version as major.minor.build: 8, 8 and 16 bits, most significant first."""
    return f"{raw >> 24 & 0xFF}.{raw >> 16 & 0xFF}.{raw & 0xFFFF}"


class DiscoveryState:
    """Keeps the newest status of every sonar. Accepts any datagram.

    Memory is bounded by `max_sonars`: while that many are present, others are rejected.

    Attributes:
        statuses: accepted datagrams.
        rejects: rejected datagrams by reason: short_message, bad_magic, duplicate, too_many_sonars.
    """

    def __init__(self, max_sonars: int = MAX_SONARS) -> None:
        self.statuses = 0
        self.rejects: Counter[str] = Counter()
        self._max_sonars = max_sonars
        self._sonars: dict[SonarKey, DiscoveredSonar] = {}

    @property
    def sonars(self) -> Mapping[SonarKey, DiscoveredSonar]:
        """All remembered sonars, including those that are gone."""
        return self._sonars

    def present(self, now_ns: int) -> list[DiscoveredSonar]:
        """Return the sonars that are not gone, in order of their first status."""
        there = (seen for seen in self._sonars.values() if not seen.gone(now_ns))
        return sorted(there, key=lambda seen: seen.first_seen_ns)

    def feed(
        self, datagram: bytes, source_address: str | None, arrival_ns: int
    ) -> DiscoveredSonar | Reject:
        """Process a datagram of the status port and return the updated sonar.

        Args:
            datagram: any size and content.
            source_address: of the datagram, dotted.
            arrival_ns: on the host's monotonic clock.

        Returns:
            The sonar, or the reason why the datagram is no update.
        """
        status = decode_status(datagram)
        if isinstance(status, Reject):
            return self._refuse(status)
        key = status.model.part_number, status.device_id
        before = self._sonars.get(key)
        if before is not None and _is_copy(before, status, arrival_ns):
            return self._refuse(
                Reject("duplicate", f"copy of the last status of {status.device_id}", 0)
            )
        if before is None and not self._has_room(arrival_ns):
            detail = f"{self._max_sonars} sonars are already present"
            return self._refuse(Reject("too_many_sonars", detail, 0))
        self.statuses += 1
        seen = _discovered(status, source_address, arrival_ns)
        if before is not None and not before.gone(arrival_ns):
            seen = replace(seen, first_seen_ns=before.first_seen_ns, count=before.count + 1)
        self._sonars[key] = seen
        return seen

    def _has_room(self, now_ns: int) -> bool:
        if len(self._sonars) < self._max_sonars:
            return True
        for key in [key for key, seen in self._sonars.items() if seen.gone(now_ns)]:
            del self._sonars[key]
        return len(self._sonars) < self._max_sonars

    def _refuse(self, reject: Reject) -> Reject:
        self.rejects[reject.reason] += 1
        return reject


def _is_copy(before: DiscoveredSonar, status: Status, arrival_ns: int) -> bool:
    return status == before.status and arrival_ns - before.last_seen_ns <= DUPLICATE_NS


def _discovered(status: Status, source_address: str | None, arrival_ns: int) -> DiscoveredSonar:
    address = str(status.address)
    if source_address is not None and not _is_host_address(status.address):
        address = source_address
    return DiscoveredSonar(address, status, status.model, arrival_ns, arrival_ns, 1, source_address)


def _is_host_address(address: IPv4Address) -> bool:
    return not (address.is_unspecified or address.is_multicast or address.is_reserved)
