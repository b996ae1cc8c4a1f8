"""What is wrong and what to do about it, from a status, own addresses, or a socket's error. Pure.

Every finding says who is concerned, what was seen and what helps, in one line.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from typing import TYPE_CHECKING, Final, Literal

from oculus_driver.models import UNKNOWN
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oculus_driver.discovery.state import DiscoveredSonar
    from oculus_driver.status import Status

Severity = Literal["note", "warning", "error"]
"""error: no pings until somebody acts. warning: pings may come. note: good to know."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One condition.

    Attributes:
        code: a name to decide and count by; the functions below list theirs.
        severity: whether pings can come all the same.
        text: one line for a person: who, what, and what to do.
    """

    code: str
    severity: Severity
    text: str


def status_findings(
    status: Status, own_addresses: Iterable[IPv4Address] = (), *, connected: bool = False
) -> list[Finding]:
    """Return what the sonar says about itself that a user should know, the worst first.

    Codes: boot_loader, booting, overheated, hot, transmitter_failed, held, unknown_model.

    Args:
        status: the newest.
        own_addresses: of this host, to tell an own client from another's.
        connected: we hold the sonar ourselves: that it is held is no finding.
    """
    found = [*_state_findings(status), *_health_findings(status)]
    if status.busy and not connected:
        found.append(_in_use_finding(status, frozenset(own_addresses)))
    if status.model.family is UNKNOWN:
        text = f"model not known ({status.model.name}): settings go to it unchecked"
        found.append(_finding("unknown_model", "warning", status, text))
    rank = {"error": 0, "warning": 1, "note": 2}
    return sorted(found, key=lambda finding: rank[finding.severity])


def subnet_finding(status: Status, own_addresses: Iterable[IPv4Address]) -> Finding | None:
    """Return why the sonar can be heard and not reached, None where it can be reached.

    Broadcasts come across subnets, connections do not: the sonar has no router to answer through.

    Args:
        status: of the sonar, for its address and mask.
        own_addresses: of this host; those it would use towards the sonar, or all. Empty means
            that it has no way to the sonar at all.

    Returns:
        Code wrong_subnet.
    """
    own = list(own_addresses)
    mask = int(status.netmask)
    if any(int(address) & mask == int(status.address) & mask for address in own):
        return None
    here = "no address that leads there" if not own else ", ".join(map(str, own))
    text = (
        f"in another subnet: it has {status.address} with mask {status.netmask}, this host has "
        f"{here}. Give this host an address in the sonar's subnet{_example_address(status)}, "
        f"or the sonar one in this host's"
    )
    return _finding("wrong_subnet", "error", status, text)


def discovery_findings(
    sonar: DiscoveredSonar, own_addresses: Iterable[IPv4Address], *, connected: bool = False
) -> list[Finding]:
    """Return all findings about a sonar that was heard, the worst first.

    Codes: those of `status_findings`, wrong_subnet and address_differs.
    """
    own, status = list(own_addresses), sonar.status
    subnet = subnet_finding(status, own)
    found = [] if subnet is None else [subnet]
    found += status_findings(status, own, connected=connected)
    if sonar.source_address not in (None, str(status.address)):
        text = (
            f"speaks from {sonar.source_address} and calls itself {status.address}: "
            f"connecting to {sonar.address}. If that fails, look for a router in between"
        )
        found.append(_finding("address_differs", "warning", status, text))
    return found


def bind_finding(error: OSError, host: str, port: int = STATUS_PORT) -> Finding:
    """Return why a status port cannot be listened on.

    Codes: port_in_use, no_permission, no_such_address, socket_error.
    """
    where = f"UDP port {port} of {host}"
    match error.errno:
        case errno.EADDRINUSE:
            text = f"{where} is held by a program that does not share it: stop that program"
            return Finding("port_in_use", "error", text)
        case errno.EACCES | errno.EPERM:
            text = f"{where} is not allowed to this user: check the system's rules for ports"
            return Finding("no_permission", "error", text)
        case errno.EADDRNOTAVAIL:
            text = f"{host} is no address of this host: listen on 0.0.0.0 or an own address"
            return Finding("no_such_address", "error", text)
    text = f"{where} cannot be listened on: {_error_text(error)}"
    return Finding("socket_error", "error", text)


def connection_finding(error: OSError, address: str, port: int = TCP_PORT) -> Finding:
    """Return why a connection to a sonar failed or broke.

    Codes: refused, timed_out, unreachable, reset, no_permission, socket_error.
    """
    where = f"TCP port {port} of {address}"
    if isinstance(error, TimeoutError) or error.errno == errno.ETIMEDOUT:
        text = (
            f"{where} does not answer: check power and cable, wait 20 s after power-up, "
            f"and that {address} is the sonar's address in this host's subnet"
        )
        return Finding("timed_out", "error", text)
    match error.errno:
        case errno.ECONNREFUSED:
            text = f"{where} refuses: the sonar is still starting, or {address} is no sonar"
            return Finding("refused", "error", text)
        case errno.ENETUNREACH | errno.EHOSTUNREACH | errno.ENETDOWN | errno.EHOSTDOWN:
            text = (
                f"{address} cannot be reached from this host: give it an address in the sonar's "
                f"subnet and see that its network port is up"
            )
            return Finding("unreachable", "error", text)
        case errno.ECONNRESET | errno.EPIPE | errno.ECONNABORTED:
            text = f"{where} closed the connection: another client, a restart, or the cable"
            return Finding("reset", "warning", text)
        case errno.EACCES | errno.EPERM:
            text = f"{where} is blocked on this host: check its firewall"
            return Finding("no_permission", "error", text)
    return Finding("socket_error", "error", f"{where}: {_error_text(error)}")


def silence_finding(port: int = STATUS_PORT) -> Finding:
    """Return what may be wrong where no sonar was heard at all. Code no_status."""
    text = (
        f"no sonar is heard on UDP port {port}: check power and cable, that no firewall drops "
        f"the port, and that the host takes broadcasts from other subnets (on Linux strict "
        f"reverse-path filtering drops them); a sonar with a known address can be connected "
        f"to all the same"
    )
    return Finding("no_status", "error", text)


def _state_findings(status: Status) -> Iterator[Finding]:
    reason = status.pause_reason
    if reason is not None:
        remedy = _PAUSE_REMEDIES.get(reason, _POWER_CYCLE)
        text = f"halted in its boot loader ({reason}) and sends no pings: {remedy}"
        yield _finding("boot_loader", "error", status, text)
    elif status.master_state != "running":
        text = f"{status.master_state}: wait up to 20 s after power-up"
        yield _finding("booting", "warning", status, text)


_POWER_CYCLE: Final = "switch it off and on, check the supply's voltage, use the maker's cable"
_PAUSE_REMEDIES: Final = {
    "magnetic switch": "take the magnet away from the switch, then switch it off and on",
    "flash error": "update its firmware with the maker's software",
    "firmware error": "update its firmware with the maker's software",
    "compatibility error": "update its firmware with the maker's software",
}


def _health_findings(status: Status) -> Iterator[Finding]:
    if status.temperature_state == "shut down":
        text = f"overheated{_max_temperature(status)} and has stopped its pings: put it under water"
        yield _finding("overheated", "error", status, text)
    elif status.temperature_state == "high":
        text = (
            f"hot{_max_temperature(status)} and pings at a lower rate: "
            "put it under water or in standby"
        )
        yield _finding("hot", "warning", status, text)
    if status.transmitter_failed:
        text = "its transmit circuit has failed: pictures will be dark, the maker must repair it"
        yield _finding("transmitter_failed", "error", status, text)


def _in_use_finding(status: Status, own_addresses: frozenset[IPv4Address]) -> Finding:
    client = status.client_address
    if client is None:
        who = "a client that it does not name"
    elif client in own_addresses or client.is_loopback:
        who = f"another program on this host ({client})"
    else:
        who = str(client)
    text = f"held by {who}, and it serves one client at a time: stop that one first"
    return _finding("held", "error", status, text)


def _finding(code: str, severity: Severity, status: Status, text: str) -> Finding:
    name = f"{status.model.name} {status.device_id} at {status.address}"
    return Finding(code, severity, f"{name}: {text}")


def _max_temperature(status: Status) -> str:
    known = [temperature for temperature in status.temperatures_c if temperature is not None]
    return f" ({max(known):.1f} °C inside)" if known else ""


def _example_address(status: Status) -> str:
    """Return another address of the sonar's subnet, as a hint, where its mask leaves one."""
    try:
        network = IPv4Network((int(status.address), str(status.netmask)), strict=False)
    except ValueError:  # ones after zeros in the mask
        return ""
    for step in (1, -1):
        neighbour = int(status.address) + step
        if int(network.network_address) < neighbour < int(network.broadcast_address):
            return f" (such as {IPv4Address(neighbour)}/{network.prefixlen})"
    return ""


def _error_text(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
