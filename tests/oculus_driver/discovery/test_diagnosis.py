"""Findings: what is wrong, and what to do."""

from __future__ import annotations

import errno
from ipaddress import IPv4Address
from typing import Any

import pytest

from oculus_driver.discovery.diagnosis import (
    Finding,
    bind_finding,
    connection_finding,
    discovery_findings,
    silence_finding,
    status_findings,
    subnet_finding,
)
from oculus_driver.discovery.listener import addresses_towards
from oculus_driver.discovery.state import DiscoveredSonar, DiscoveryState
from oculus_driver.encode import encode_status
from oculus_driver.status import PAUSE_REASONS, Status

RUNNING = 3


def sighting(source: str | None = None, **values: Any) -> DiscoveredSonar:
    given: dict[str, Any] = {"device_id": 7892, "address": "192.168.2.3", "status_bits": RUNNING}
    seen = DiscoveryState().feed(encode_status(**(given | values)), source, 0)
    assert isinstance(seen, DiscoveredSonar)
    return seen


def status(**values: Any) -> Status:
    return sighting(**values).status


def codes(found: list[Finding]) -> list[str]:
    return [finding.code for finding in found]


def own(*addresses: str) -> list[IPv4Address]:
    return [IPv4Address(address) for address in addresses]


def test_a_sound_free_sonar_has_no_findings() -> None:
    assert status_findings(status()) == []
    assert discovery_findings(sighting("192.168.2.3"), own("192.168.2.9")) == []


@pytest.mark.parametrize("reason", range(8))
@pytest.mark.parametrize("master", [0, 1])
def test_a_halt_in_the_boot_loader_states_the_reason_and_what_to_do(
    master: int, reason: int
) -> None:
    # quirk 18: after a bad power-up or with a bad cable
    (finding,) = status_findings(status(status_bits=master | reason << 3))
    assert (finding.code, finding.severity) == ("boot_loader", "error")
    assert f"({PAUSE_REASONS[reason]})" in finding.text
    assert any(word in finding.text for word in ("cable", "firmware with", "the magnet"))


def test_a_sonar_that_boots_is_waited_for() -> None:
    (finding,) = status_findings(status(status_bits=2))
    assert (finding.code, finding.severity) == ("booting", "warning")


def test_heat_is_reported_with_the_warmest_place() -> None:
    # quirk 17: first a lower rate, then no pings
    hot = (20.0, 21.0, float("nan"), 61.5, 20.0, 20.0, 20.0, 20.0)
    (warning,) = status_findings(status(status_bits=RUNNING | 1 << 14, temperatures_c=hot))
    (error,) = status_findings(status(status_bits=RUNNING | 3 << 14, temperatures_c=hot))
    assert (warning.code, warning.severity) == ("hot", "warning")
    assert (error.code, error.severity) == ("overheated", "error")
    assert "61.5 °C" in warning.text
    assert "61.5 °C" in error.text


def test_a_failed_transmitter_is_reported() -> None:
    assert codes(status_findings(status(status_bits=RUNNING | 1 << 16))) == ["transmitter_failed"]


@pytest.mark.parametrize(
    ("values", "who"),
    [
        ({"client_address": "192.168.2.10"}, "192.168.2.10"),
        ({"client_address": "192.168.2.9"}, "another program on this host (192.168.2.9)"),
        ({"client_address": "127.0.0.1"}, "another program on this host (127.0.0.1)"),
        ({"status_bits": RUNNING | 1 << 7}, "unknown client"),
    ],
)
def test_who_holds_the_sonar_is_named(values: dict[str, Any], who: str) -> None:
    # quirk 20: one client only, and the status shows who
    (finding,) = status_findings(status(**values), own("192.168.2.9"))
    assert (finding.code, finding.severity) == ("held", "error")
    assert who in finding.text


def test_that_we_hold_it_ourselves_is_no_finding() -> None:
    assert status_findings(status(client_address="192.168.2.9"), connected=True) == []


def test_an_unknown_model_is_a_warning_and_no_more() -> None:
    # quirk 24
    (finding,) = status_findings(status(part_number=9999))
    assert (finding.code, finding.severity) == ("unknown_model", "warning")
    assert "part 9999" in finding.text


def test_the_worst_comes_first() -> None:
    found = status_findings(status(part_number=0, status_bits=1 << 14 | 1 << 16 | 2))
    assert codes(found)[0] == "transmitter_failed"
    assert [finding.severity for finding in found] == ["error", "warning", "warning", "warning"]


@pytest.mark.parametrize("reachable_from", ["192.168.2.9", "192.168.2.254"])
def test_a_host_in_the_sonars_subnet_is_fine(reachable_from: str) -> None:
    assert subnet_finding(status(), own("10.0.0.1", reachable_from)) is None


def test_another_subnet_names_both_addresses_and_one_that_would_do() -> None:
    # quirk 19: the status is heard across subnets, TCP fails
    finding = subnet_finding(
        status(address="169.254.37.93", netmask="255.255.0.0"), own("192.168.2.9")
    )
    assert finding is not None
    assert (finding.code, finding.severity) == ("wrong_subnet", "error")
    for part in ("169.254.37.93", "255.255.0.0", "192.168.2.9", "such as 169.254.37.94/16"):
        assert part in finding.text


@pytest.mark.parametrize(
    ("address", "netmask", "example"),
    [
        ("192.168.2.254", "255.255.255.0", "(such as 192.168.2.253/24)"),
        ("192.168.2.3", "255.0.255.0", "subnet, or"),
        ("192.168.2.3", "255.255.255.255", "subnet, or"),
    ],
)
def test_the_example_lies_in_the_sonars_subnet(address: str, netmask: str, example: str) -> None:
    finding = subnet_finding(status(address=address, netmask=netmask), own("10.0.0.1"))
    assert finding is not None
    assert example in finding.text


def test_no_way_at_all_is_another_subnet_too() -> None:
    finding = subnet_finding(status(), [])
    assert finding is not None
    assert finding.code == "wrong_subnet"
    assert "no route" in finding.text


def test_the_subnet_comes_first_of_all_findings() -> None:
    seen = sighting("10.0.0.7", client_address="192.168.2.10", part_number=9999)
    found = codes(discovery_findings(seen, own("10.0.0.1")))
    assert found == ["wrong_subnet", "held", "unknown_model", "address_differs"]


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.EADDRINUSE, "port_in_use"),
        (errno.EACCES, "no_permission"),
        (errno.EADDRNOTAVAIL, "no_such_address"),
        (errno.ENOBUFS, "socket_error"),
    ],
)
def test_a_port_that_cannot_be_had_is_named(number: int, code: str) -> None:
    finding = bind_finding(OSError(number, "as the system reports"), "10.0.0.1", 52102)
    assert (finding.code, finding.severity) == (code, "error")
    assert "10.0.0.1" in finding.text


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, ""), "refused"),
        (TimeoutError(), "timed_out"),
        (OSError(errno.ETIMEDOUT, ""), "timed_out"),
        (OSError(errno.EHOSTUNREACH, ""), "unreachable"),
        (OSError(errno.ENETUNREACH, ""), "unreachable"),
        (ConnectionResetError(errno.ECONNRESET, ""), "reset"),
        (BrokenPipeError(errno.EPIPE, ""), "reset"),
        (PermissionError(errno.EPERM, ""), "no_permission"),
        (OSError("no number"), "socket_error"),
    ],
)
def test_a_connection_that_fails_has_a_cause(error: OSError, code: str) -> None:
    finding = connection_finding(error, "192.168.2.3")
    assert finding.code == code
    assert "192.168.2.3" in finding.text


def test_silence_names_the_port_and_the_firewall() -> None:
    assert "52102" in silence_finding().text
    assert "firewall" in silence_finding().text


def test_every_finding_is_one_line() -> None:
    seen = sighting("10.0.0.7", status_bits=0b110_001 | 3 << 14 | 1 << 16, part_number=9999)
    found = [*discovery_findings(seen, []), silence_finding(), bind_finding(OSError(), "a")]
    assert all(finding.text and "\n" not in finding.text for finding in found)


def test_the_way_to_this_host_is_from_itself() -> None:
    assert addresses_towards("127.0.0.1") == own("127.0.0.1")


def test_there_is_no_way_to_a_broadcast_address() -> None:
    assert addresses_towards("255.255.255.255") == []
