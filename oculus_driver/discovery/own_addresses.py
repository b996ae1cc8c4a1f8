"""The addresses of this host, as far as a sonar is concerned."""

from __future__ import annotations

import socket
from ipaddress import IPv4Address

from oculus_driver.wire import TCP_PORT


def addresses_towards(address: str) -> list[IPv4Address]:
    """Return the address that this host would speak to `address` from; empty: it has no way.

    `address` is dotted: a name would have to be looked up, which can take seconds.
    Asks the system's routes and sends nothing. A way through a router counts as one: compare
    with the sonar's mask (`oculus_driver.discovery.diagnosis.subnet_finding`).
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, TCP_PORT))
        except OSError:
            return []
        return [IPv4Address(probe.getsockname()[0])]
