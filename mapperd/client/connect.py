"""Addresses of daemons, and how a connection is made and kept."""

import asyncio
import os
import random
import ssl
from dataclasses import dataclass
from pathlib import Path

from mapperd.client.errors import EndedError
from mapperd.client.protocol import ClientProtocol

__all__ = [
    "DaemonAddress",
    "RetryDelay",
    "daemon_address",
    "opened",
    "read",
    "reason_of",
    "send",
    "with_hint",
]


@dataclass(frozen=True, slots=True)
class DaemonAddress:
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


def daemon_address(address: str) -> DaemonAddress:
    """Of `HOST:PORT`, `[IPv6]:PORT`, the path of a Unix socket, or "" for this computer's daemon.

    Raises:
        ValueError: it is none of these.
    """
    if not address:
        return DaemonAddress(_usual_paths())
    if "/" in address:
        return DaemonAddress((Path(address),))
    host, sign, port = address.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (sign and host and port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
        raise ValueError(f"{address!r}: HOST:PORT or the path of a socket was expected")
    return DaemonAddress(host=host, port=int(port))


def _usual_paths() -> tuple[Path, ...]:
    # Only here: the settings' types take longer to import than all of this package.
    from mapperd.config.tree import Config  # noqa: PLC0415
    from mapperd.wire.socket_paths import socket_places  # noqa: PLC0415

    return tuple(socket_places(Config(), os.environ))


READ_BYTES = 1 << 16
CONNECT_S = 10.0
SILENCE_S = 6.0
"""The daemon says something once a second."""

WAIT_S, LONGEST_WAIT_S = 0.2, 5.0
SOUND_S = 2.0
"""A connection that lasted as long was a good one: the next attempt comes soon."""

UNSENT_BYTES = 1 << 16
"""Of a daemon that does not read; no more is acknowledged to it meanwhile."""

PLAIN = frozenset({"PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE", "WRONG_VERSION_NUMBER"})
"""What TLS makes of a greeting without it, as versions of OpenSSL say it."""


async def opened(
    place: DaemonAddress, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect.

    Raises:
        OSError: nobody is there.
    """
    try:
        async with asyncio.timeout(CONNECT_S):
            return await _opened(place, tls)
    except TimeoutError as error:
        raise ConnectionError("nobody answers") from error


async def _opened(
    place: DaemonAddress, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    if place.paths:
        return await asyncio.open_unix_connection(place.path)
    name = place.host if tls else None
    return await asyncio.open_connection(place.host, place.port, ssl=tls, server_hostname=name)


async def read(reader: asyncio.StreamReader) -> bytes:
    """What comes next; nothing at the end.

    Raises:
        OSError: the connection broke, or nothing came for long.
    """
    try:
        async with asyncio.timeout(SILENCE_S):
            return await reader.read(READ_BYTES)
    except TimeoutError as error:
        raise ConnectionError(f"nothing was heard for {SILENCE_S:g} s") from error


def send(writer: asyncio.StreamWriter, protocol: ClientProtocol) -> None:
    """Send what is to be said."""
    if writer.is_closing():
        return
    is_read = writer.transport.get_write_buffer_size() < UNSENT_BYTES
    if data := protocol.outgoing(acknowledge=is_read):
        writer.write(data)


def reason_of(error: OSError) -> str:
    """For a person.

    Raises:
        EndedError: trying again does not mend it.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        raise EndedError(f"not trusted: {error.verify_message}", "not_trusted") from error
    if isinstance(error, ssl.SSLError) and error.reason in PLAIN:
        return "what answers there speaks no TLS: it is a plain socket, to be connected to without"
    if isinstance(error, PermissionError):
        raise EndedError(f"you may not: {error.strerror}", "no_permission") from error
    return str(error.strerror or error) or type(error).__name__


def with_hint(
    reason: str, place: DaemonAddress, tls: ssl.SSLContext | None, *, is_greeted: bool
) -> str:
    """Why a connection ended, and what may be amiss where nothing was said on it."""
    if is_greeted or tls is not None or place.paths:
        return reason
    return f"{reason} without a greeting: its socket may want TLS"


class RetryDelay:
    """How long to wait between them: longer each time, unless a connection was a good one."""

    def __init__(self) -> None:
        self._wait_s = WAIT_S
        self._jitter = random.Random()  # noqa: S311 no secret

    async def wait(self, lasted_s: float) -> None:
        """Wait for the next one.

        Args:
            lasted_s: of the last.
        """
        if lasted_s > SOUND_S:
            self._wait_s = WAIT_S
        await asyncio.sleep(self._wait_s * self._jitter.uniform(0.5, 1.0))
        self._wait_s = min(LONGEST_WAIT_S, 2 * self._wait_s)
