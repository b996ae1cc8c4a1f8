"""Where a daemon's map stream is."""

import os
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Place", "place_of"]


@dataclass(frozen=True, slots=True)
class Place:
    """Where to connect to.

    Attributes:
        paths: of Unix sockets, of which the first that exists is taken; none of TCP.
        host, port: of TCP.
    """

    paths: tuple[Path, ...] = ()
    host: str = ""
    port: int = 0

    def __str__(self) -> str:
        """For a person."""
        if not self.paths:
            return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
        return str(self.path)

    @property
    def path(self) -> Path:
        """Of the Unix socket to be tried now."""
        return next((path for path in self.paths if path.exists()), self.paths[0])


def place_of(address: str) -> Place:
    """Of `HOST:PORT`, `[IPv6]:PORT`, the path of a Unix socket, or "" for this computer's daemon.

    Raises:
        ValueError: it is none of these.
    """
    if not address:
        return Place(_usual_paths())
    if "/" in address:
        return Place((Path(address),))
    host, sign, port = address.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (sign and host and port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
        raise ValueError(f"{address!r}: HOST:PORT or the path of a socket was expected")
    return Place(host=host, port=int(port))


def _usual_paths() -> tuple[Path, ...]:
    # Only here: the settings' types take longer to import than all of this package.
    from mapperd.config.tree import Config  # noqa: PLC0415
    from mapperd.wire.socket_paths import map_socket_places  # noqa: PLC0415

    return tuple(map_socket_places(Config(), os.environ))
