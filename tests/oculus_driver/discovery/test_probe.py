"""The first layer that fails, and what to do about it."""

from __future__ import annotations

from collections import Counter
from ipaddress import IPv4Address
from typing import Any

import pytest

from oculus_driver.discovery.probe import LAYERS, ProbeResult, evaluate, first_failure
from oculus_driver.discovery.state import DiscoveredSonar, DiscoveryState
from oculus_driver.encode import encode_status

OWN = (IPv4Address("192.168.2.10"),)


def seen(**values: Any) -> DiscoveredSonar:
    status: dict[str, Any] = {
        "device_id": 9,
        "address": "192.168.2.3",
        "netmask": "255.255.255.0",
    } | values
    sonar = DiscoveryState().feed(encode_status(**status), None, 0)
    assert isinstance(sonar, DiscoveredSonar)
    return sonar


def evidence(**values: Any) -> ProbeResult:
    """Of a healthy sonar, except for `values`."""
    good: dict[str, Any] = {
        "address": "192.168.2.3",
        "sonar": seen(),
        "own_addresses": OWN,
        "status_port": 52102,
        "connected": True,
        "listened_s": 4.0,
        "bytes_received": 1000,
        "messages": Counter({0x23: 3}),
        "pings": 3,
    }
    return ProbeResult(**(good | values))


def test_a_sonar_that_is_well_passes_every_layer() -> None:
    layers = evaluate(evidence())
    assert [(layer.name, layer.verdict) for layer in layers] == [(name, "ok") for name in LAYERS]
    assert first_failure(layers) is None


REFUSED = ConnectionRefusedError(111, "Connection refused")
NOTHING: dict[str, Any] = {
    "connected": False,
    "bytes_received": 0,
    "messages": Counter(),
    "pings": 0,
}
SILENT = NOTHING | {"connected": True}


@pytest.mark.parametrize(
    ("values", "layer", "words"),
    [
        (NOTHING | {"address": None, "sonar": None}, "address", "check power and cable"),
        (
            NOTHING | {"address": None, "sonar": None, "listen_error": "port is held"},
            "address",
            "port is held",
        ),
        (
            NOTHING | {"own_addresses": (IPv4Address("10.0.0.5"),), "connect_error": REFUSED},
            "address",
            "another subnet",
        ),  # quirk 19
        (NOTHING | {"connect_error": REFUSED}, "port", "refuses"),
        (NOTHING | {"connect_error": TimeoutError()}, "port", "does not answer"),
        (
            NOTHING | {"connect_error": REFUSED, "sonar": seen(client_address="192.168.2.77")},
            "port",
            "192.168.2.77",
        ),  # quirk 20
        (SILENT, "bytes", "switch its power off"),  # quirk 23
        (SILENT | {"ended": True}, "bytes", "another client"),  # quirk 20
        (SILENT | {"sonar": seen(client_address="192.168.2.77")}, "bytes", "192.168.2.77"),
        (
            SILENT | {"bytes_received": 500, "bytes_rejected": 500},
            "frames",
            "500 bytes",
        ),
        (
            {"pings": 0, "ping_rejects": Counter(size_mismatch=4)},
            "pings",
            "size_mismatch 4",
        ),
        (
            {"pings": 0, "messages": Counter({0xFF: 3}), "sonar": seen(status_bits=0xC003)},
            "pings",
            "under water",
        ),  # quirk 17
        (
            {"pings": 0, "messages": Counter({0xFF: 3}), "sonar": seen(status_bits=0x31)},
            "pings",
            "brown-out",
        ),  # quirk 18
        ({"pings": 0, "messages": Counter({0xFF: 3}), "asked_for_pings": True}, "pings", "request"),
    ],
)
def test_the_first_layer_that_fails_is_named(
    values: dict[str, Any], layer: str, words: str
) -> None:
    layers = evaluate(evidence(**values))
    failure = first_failure(layers)
    assert failure is not None
    assert failure.name == layer
    assert words in failure.text
    behind = layers[LAYERS.index(layer) + 1 :]
    assert all(one.verdict == "not tested" for one in behind)


@pytest.mark.parametrize(
    ("values", "layer", "words"),
    [
        ({"sonar": None}, "address", "no status on UDP port 52102"),
        ({"bytes_rejected": 10}, "frames", "10 of 1000 bytes"),
        ({"messages": Counter()}, "frames", "no complete message"),
        ({"lost_pings": 2}, "pings", "lost: 2"),
        ({"ping_rejects": Counter(empty=1)}, "pings", "empty 1"),
    ],
)
def test_what_is_doubtful_fails_nothing(values: dict[str, Any], layer: str, words: str) -> None:
    layers = evaluate(evidence(**values))
    assert first_failure(layers) is None
    found = layers[LAYERS.index(layer)]
    assert found.verdict == "doubtful"
    assert words in found.text


def test_standby_is_no_failure_as_long_as_nobody_asked_for_pings() -> None:  # quirk 16
    last = evaluate(evidence(pings=0, messages=Counter({0xFF: 3})))[-1]
    assert (last.verdict, "in standby" in last.text) == ("not tested", True)


def test_full_ping_results_are_named_as_the_cause() -> None:
    failure = first_failure(evaluate(evidence(pings=0, messages=Counter({0x22: 3}))))
    assert failure is not None
    assert failure.text.startswith("3 full ping results")
