"""Problems and remedies derived from a status, local addresses, or a socket error. Pure.

Every finding is one line: the sonar, the problem, and the remedy.
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
"""error: no pings until somebody acts. warning: pings may arrive. note: for information."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem.

    Attributes:
        code: machine-readable name; the functions below list theirs.
        severity: whether pings can arrive all the same.
        text: one line for the user: sonar, problem, remedy.
    """

    code: str
    severity: Severity
    text: str


def status_findings(
    status: Status, own_addresses: Iterable[IPv4Address] = (), *, connected: bool = False
) -> list[Finding]:
    """Return the problems in a sonar's status, most severe first.

    Codes: boot_loader, booting, overheated, hot, transmitter_failed, held, unknown_model.

    Args:
        status: the newest status.
        own_addresses: addresses of this host, to recognise clients on this host.
        connected: this program uses the sonar: no finding "held".
    """
    found = [*_state_findings(status), *_health_findings(status)]
    if status.busy and not connected:
        found.append(_in_use_finding(status, frozenset(own_addresses)))
    if status.model.family is UNKNOWN:
        text = f"unknown model ({status.model.name}): settings are not checked"
        found.append(_finding("unknown_model", "warning", status, text))
    rank = {"error": 0, "warning": 1, "note": 2}
    return sorted(found, key=lambda finding: rank[finding.severity])


def subnet_finding(status: Status, own_addresses: Iterable[IPv4Address]) -> Finding | None:
    """Return why the sonar can be received but not reached, None if it can be reached.

    Broadcasts cross subnets, connections do not: the sonar has no gateway for its answers.

    Args:
        status: gives the sonar's address and netmask.
        own_addresses: addresses of this host: all, or those it would use towards the sonar. Empty:
            it has no route to the sonar.

    Returns:
        Code wrong_subnet.
    """
    own = list(own_addresses)
    mask = int(status.netmask)
    if any(int(address) & mask == int(status.address) & mask for address in own):
        return None
    here = "no route to it" if not own else ", ".join(map(str, own))
    text = (
        f"in another subnet: the sonar has {status.address} with mask {status.netmask}, this host "
        f"has {here}. Give this host an address in the sonar's subnet{_example_address(status)}, "
        f"or give the sonar one in this host's subnet"
    )
    return _finding("wrong_subnet", "error", status, text)


def discovery_findings(
    sonar: DiscoveredSonar, own_addresses: Iterable[IPv4Address], *, connected: bool = False
) -> list[Finding]:
    """Return all problems of a discovered sonar, most severe first.

    Codes: those of `status_findings`, wrong_subnet and address_differs.
    """
    own, status = list(own_addresses), sonar.status
    subnet = subnet_finding(status, own)
    found = [] if subnet is None else [subnet]
    found += status_findings(status, own, connected=connected)
    if sonar.source_address not in (None, str(status.address)):
        text = (
            f"its datagrams come from {sonar.source_address}, but its status contains "
            f"{status.address}: connecting to {sonar.address}. If that fails, look for a router "
            f"in between"
        )
        found.append(_finding("address_differs", "warning", status, text))
    return found


def bind_finding(error: OSError, host: str, port: int = STATUS_PORT) -> Finding:
    """Return why the status port cannot be opened.

    Codes: port_in_use, no_permission, no_such_address, socket_error.
    """
    where = f"UDP port {port} of {host}"
    match error.errno:
        case errno.EADDRINUSE:
            text = f"{where} is in use by a program that does not share it: stop that program"
            return Finding("port_in_use", "error", text)
        case errno.EACCES | errno.EPERM:
            text = f"{where}: permission denied: check the system's rules for ports"
            return Finding("no_permission", "error", text)
        case errno.EADDRNOTAVAIL:
            text = f"{host} is not an address of this host: listen on 0.0.0.0 or a local address"
            return Finding("no_such_address", "error", text)
    text = f"{where} cannot be opened: {_error_text(error)}"
    return Finding("socket_error", "error", text)


def connection_finding(error: OSError, address: str, port: int = TCP_PORT) -> Finding:
    """Return why a connection to a sonar failed or broke.

    Codes: refused, timed_out, unreachable, reset, no_permission, socket_error.
    """
    where = f"TCP port {port} of {address}"
    if isinstance(error, TimeoutError) or error.errno == errno.ETIMEDOUT:
        text = (
            f"{where} does not answer: check power and cable, wait 20 s after power-up, "
            f"and check that {address} is the sonar's address in this host's subnet"
        )
        return Finding("timed_out", "error", text)
    match error.errno:
        case errno.ECONNREFUSED:
            text = f"{where} refuses connections: the sonar is booting, or {address} is not a sonar"
            return Finding("refused", "error", text)
        case errno.ENETUNREACH | errno.EHOSTUNREACH | errno.ENETDOWN | errno.EHOSTDOWN:
            text = (
                f"{address} cannot be reached: give this host an address in the sonar's subnet "
                f"and check that its network port is up"
            )
            return Finding("unreachable", "error", text)
        case errno.ECONNRESET | errno.EPIPE | errno.ECONNABORTED:
            text = (
                f"{where} reset the connection: check for another client, a restart, or a bad cable"
            )
            return Finding("reset", "warning", text)
        case errno.EACCES | errno.EPERM:
            text = f"{where} is blocked by this host: check its firewall"
            return Finding("no_permission", "error", text)
    return Finding("socket_error", "error", f"{where}: {_error_text(error)}")


def silence_finding(port: int = STATUS_PORT) -> Finding:
    """Return possible reasons why no sonar was discovered. Code no_status."""
    text = (
        f"no status received on UDP port {port}: check power and cable, that no firewall drops "
        f"the port, and that this host accepts broadcasts from other subnets (on Linux strict "
        f"reverse-path filtering drops them); connecting to a known address may still work"
    )
    return Finding("no_status", "error", text)


def _state_findings(status: Status) -> Iterator[Finding]:
    reason = status.pause_reason
    if reason is not None:
        remedy = _PAUSE_REMEDIES.get(reason, _POWER_CYCLE)
        text = f"halted in the boot loader ({reason}), no pings: {remedy}"
        yield _finding("boot_loader", "error", status, text)
    elif status.master_state != "running":
        text = f"{status.master_state}: wait up to 20 s after power-up"
        yield _finding("booting", "warning", status, text)


_POWER_CYCLE: Final = "switch it off and on, check the supply voltage, use the vendor's cable"
_PAUSE_REMEDIES: Final = {
    "magnetic switch": "remove the magnet from the switch, then switch the sonar off and on",
    "flash error": "update its firmware with the vendor's software",
    "firmware error": "update its firmware with the vendor's software",
    "compatibility error": "update its firmware with the vendor's software",
}


def _health_findings(status: Status) -> Iterator[Finding]:
    if status.temperature_state == "shut down":
        text = f"overheated{_max_temperature(status)}, pings stopped: put it under water"
        yield _finding("overheated", "error", status, text)
    elif status.temperature_state == "high":
        text = (
            f"hot{_max_temperature(status)}, pings at a lower rate: "
            "put it under water or into standby"
        )
        yield _finding("hot", "warning", status, text)
    if status.transmitter_failed:
        text = "transmit circuit failed: images will be dark, the vendor must repair it"
        yield _finding("transmitter_failed", "error", status, text)


def _in_use_finding(status: Status, own_addresses: frozenset[IPv4Address]) -> Finding:
    client = status.client_address
    if client is None:
        who = "an unknown client"
    elif client in own_addresses or client.is_loopback:
        who = f"another program on this host ({client})"
    else:
        who = str(client)
    text = f"in use by {who}: it serves one client at a time, stop the other one first"
    return _finding("held", "error", status, text)


def _finding(code: str, severity: Severity, status: Status, text: str) -> Finding:
    name = f"{status.model.name} {status.device_id} at {status.address}"
    return Finding(code, severity, f"{name}: {text}")


def _max_temperature(status: Status) -> str:
    known = [temperature for temperature in status.temperatures_c if temperature is not None]
    return f" ({max(known):.1f} °C inside)" if known else ""


def _example_address(status: Status) -> str:
    """Return another address in the sonar's subnet as an example, empty without one."""
    try:
        network = IPv4Network((int(status.address), str(status.netmask)), strict=False)
    except ValueError:  # not a contiguous netmask
        return ""
    for step in (1, -1):
        neighbour = int(status.address) + step
        if int(network.network_address) < neighbour < int(network.broadcast_address):
            return f" (such as {IPv4Address(neighbour)}/{network.prefixlen})"
    return ""


def _error_text(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
