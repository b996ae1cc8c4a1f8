"""Where a link's bytes come from, as one text.

| text | meaning |
|---|---|
| `udp://ADDRESS:PORT` | listen for datagrams at an address of this host |
| `tcp://HOST:PORT` | connect to a sender, and again when it is lost |
| `socket://HOST:PORT` | the same: a serial line behind a network converter |
| `serial:/dev/ttyUSB0?baud=115200` | a serial line by its path |
| `serial:NAME?baud=115200` | by the name that udev gives it under /dev/serial/by-id or by-path |
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

__all__ = ["LinkAddress", "parse_address", "serial_path"]

MAX_BAUD = 4_000_000
DEFAULT_BAUD = 115_200
HOST_PORT = re.compile(
    # No name has an empty part or one of more than 63 letters: looking it up would raise.
    r"^(?P<host>(?=[^:]{1,253}:)[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*\.?"
    r"|\[[0-9A-Fa-f:]{2,39}\]):(?P<port>[0-9]{1,5})$"
)
UDEV_NAME = re.compile(r"^[A-Za-z0-9#+\-.:=@_]{1,255}$")
UDEV_FOLDERS = (Path("/dev/serial/by-id"), Path("/dev/serial/by-path"))


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """One place that bytes come from.

    Attributes:
        kind: how it is opened.
        host, port: of networks.
        device: of serial lines, a path or a name of udev's.
        baud: of serial lines.
    """

    kind: Literal["udp", "tcp", "serial"]
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = DEFAULT_BAUD

    def __str__(self) -> str:
        """For a person."""
        return (
            self.device if self.kind == "serial" else f"{self.kind.upper()} {self.host}:{self.port}"
        )


def parse_address(text: str) -> LinkAddress:
    """Read the text of a link.

    Raises:
        ValueError: it is invalid; the message states what is allowed.
    """
    scheme, _, rest = text.partition(":")
    if scheme == "serial":
        return _serial(rest, text)
    if scheme not in ("udp", "tcp", "socket") or not rest.startswith("//"):
        raise ValueError(
            f"{text!r} is not a link; allowed: udp://ADDRESS:PORT, tcp://HOST:PORT, "
            "socket://HOST:PORT, serial:/dev/NAME?baud=115200 or serial:UDEV_NAME"
        )
    found = HOST_PORT.match(rest[2:])
    if found is None or not 1 <= int(found["port"]) <= 65535:  # noqa: PLR2004 a port is 16 bits
        raise ValueError(
            f"{text!r} lacks a host or a port from 1 to 65535; such as {scheme}://127.0.0.1:52200"
        )
    kind: Literal["udp", "tcp"] = "udp" if scheme == "udp" else "tcp"
    return LinkAddress(kind, found["host"].strip("[]"), int(found["port"]))


def serial_path(device: str) -> Path:
    """Return the path of a serial line; udev names are resolved, as they change when replugged.

    Raises:
        FileNotFoundError: nothing of that name is plugged in.
    """
    if device.startswith("/"):
        return Path(device)
    for folder in UDEV_FOLDERS:
        if (folder / device).exists():
            return folder / device
    raise FileNotFoundError(
        f"no {device!r} under {' or '.join(map(str, UDEV_FOLDERS))}: is it plugged in?"
    )


def _serial(rest: str, text: str) -> LinkAddress:
    device, _, query = rest.removeprefix("//").partition("?")
    by_path = device.startswith("/dev/") and ".." not in device
    if not by_path and not UDEV_NAME.match(device):
        raise ValueError(
            f"{text!r} names no serial line; allowed: a path under /dev, or udev's name of it"
        )
    baud = query.removeprefix("baud=") if query else str(DEFAULT_BAUD)
    if not baud.isdecimal() or not 1 <= int(baud[:10]) <= MAX_BAUD:
        raise ValueError(
            f"{text!r} has no baud rate; such as ?baud={DEFAULT_BAUD}, at most {MAX_BAUD}"
        )
    return LinkAddress("serial", device=device, baud=int(baud))
