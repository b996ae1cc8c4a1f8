"""Who reaches what is served."""

import ipaddress

__all__ = ["is_local"]


def is_local(host: str) -> bool:
    """Only this computer reaches what listens there."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
