"""Values on the command line, checked while it is read."""

from __future__ import annotations

import argparse
import math
from ipaddress import IPv4Address

_LAST_PORT = 65_535


def positive(text: str) -> float:
    """Return a number above 0."""
    value = _number(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def not_negative(text: str) -> float:
    """Return a number of at least 0."""
    value = _number(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return value


def share(text: str) -> float:
    """Return a number from 0 to 1."""
    value = _number(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value


def count(text: str) -> int:
    """Return a whole number above 0."""
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is no whole number above 0")
    return int(text)


def whole(text: str) -> int:
    """Return a whole number of at least 0."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text} is no whole number")
    return int(text)


def port(text: str) -> int:
    """Return a port; 0 stands for any free one."""
    if not text.isascii() or not text.isdigit() or int(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text} is no port (0 to {_LAST_PORT})")
    return int(text)


def address(text: str) -> str:
    """Return an IPv4 address, as sonars have."""
    try:
        return str(IPv4Address(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is no IPv4 address") from error


def endpoint(text: str) -> tuple[str, int | None]:
    """Return an address and, where it is given, a port: `192.168.2.3` or `127.0.0.1:52100`."""
    host, colon, number = text.partition(":")
    return address(host), port(number) if colon else None


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is no number") from error
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is no finite number")
    return value
