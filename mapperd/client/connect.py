"""Addresses of daemons, and connections to them."""

import asyncio
import os
import ssl
from dataclasses import dataclass
from pathlib import Path

from mapperd.client.protocol import ClientProtocol
from mapperd.client.validation import EndedError

__all__ = [
    "DaemonAddress",
    "daemon_address",
    "opened",
    "read",
    "reason_of",
    "send",
    "with_hint",
]


@dataclass(frozen=True, slots=True)
class DaemonAddress:
    """Address of a daemon.

    Attributes:
        paths: of Unix sockets; the first that exists is used. Empty for TCP.
        host, port: for TCP.
    """

    paths: tuple[Path, ...] = ()
    host: str = ""
    port: int = 0

    def __str__(self) -> str:
        """Return the address for people."""
        if not self.paths:
            return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
        return str(self.path)

    @property
    def path(self) -> Path:
        """Path of the Unix socket to connect to."""
        return next((path for path in self.paths if path.exists()), self.paths[0])


def daemon_address(address: str) -> DaemonAddress:
    """Parse `HOST:PORT`, `[IPv6]:PORT`, the path of a Unix socket, or "" for the local daemon.

    Raises:
        ValueError: it is something else.
    """
    if not address:
        return DaemonAddress(_usual_paths())
    if "/" in address:
        return DaemonAddress((Path(address),))
    host, sign, port = address.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (sign and host and port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
        example = "" if ":" in address else f", such as {address}:7471,"
        raise ValueError(f"{address!r}: expected HOST:PORT{example} or the path of a socket")
    return DaemonAddress(host=host, port=int(port))


def _usual_paths() -> tuple[Path, ...]:
    # Imported here: the settings' types take longer to import than all of this package.
    from mapperd.config.paths import socket_places  # noqa: PLC0415
    from mapperd.config.tree import Config  # noqa: PLC0415

    return tuple(socket_places(Config(), os.environ))


READ_BYTES = 1 << 16
CONNECT_TIMEOUT_S = 10.0
SILENCE_S = 6.0
"""Timeout of a read; the daemon sends something every second."""

UNSENT_BYTES = 1 << 16
"""Unsent bytes from which on nothing is acknowledged, because the daemon does not read."""

PLAIN = frozenset({"PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE", "WRONG_VERSION_NUMBER"})
"""Reasons that versions of OpenSSL give for a plain greeting."""


async def opened(
    place: DaemonAddress, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect.

    Raises:
        OSError: the connection failed.
    """
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            return await _opened(place, tls)
    except TimeoutError as error:
        raise ConnectionError("no answer") from error


async def _opened(
    place: DaemonAddress, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    if place.paths:
        return await asyncio.open_unix_connection(place.path)
    name = place.host if tls else None
    return await asyncio.open_connection(place.host, place.port, ssl=tls, server_hostname=name)


async def read(reader: asyncio.StreamReader) -> bytes:
    """Read the next bytes; empty at the end.

    Raises:
        OSError: the connection broke, or nothing arrived within `SILENCE_S`.
    """
    try:
        async with asyncio.timeout(SILENCE_S):
            return await reader.read(READ_BYTES)
    except TimeoutError as error:
        raise ConnectionError(f"the daemon sent nothing for {SILENCE_S:g} s") from error


def send(writer: asyncio.StreamWriter, protocol: ClientProtocol) -> None:
    """Send the outgoing bytes."""
    if writer.is_closing():
        return
    is_read = writer.transport.get_write_buffer_size() < UNSENT_BYTES
    if data := protocol.outgoing(acknowledge=is_read):
        writer.write(data)


def reason_of(error: OSError) -> str:
    """Return the reason of a failed connection, for people.

    Raises:
        EndedError: reconnecting does not help.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        raise EndedError(f"not trusted: {error.verify_message}", "not_trusted") from error
    if isinstance(error, ssl.SSLError) and error.reason in PLAIN:
        return "the server has no TLS: connect without it"
    if isinstance(error, PermissionError):
        raise EndedError(f"cannot connect: {error.strerror}", "no_permission") from error
    if error.errno and error.errno > 0 and not isinstance(error, ssl.SSLError):
        return os.strerror(error.errno)  # asyncio's text is that of its call
    return str(error.strerror or error) or type(error).__name__


def with_hint(
    reason: str, place: DaemonAddress, tls: ssl.SSLContext | None, *, is_greeted: bool
) -> str:
    """Add a hint to the reason why a connection ended, if the daemon sent nothing on it."""
    if is_greeted or tls is not None or place.paths:
        return reason
    return f"{reason} without a greeting: it may require TLS"
