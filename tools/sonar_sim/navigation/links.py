"""The links that carry odometry: UDP, a TCP server, a serial line."""

import asyncio
import os
import pty
import socket
import tty
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from sonar_sim.errors import SonarSimError

__all__ = ["OdometryOutlet", "link_named"]

MAX_UNREAD_BYTES = 1 << 20
"""A TCP client that reads slower than this is let go."""


class OdometryOutlet(Protocol):
    """One way out."""

    @property
    def name(self) -> str:
        """Where it leads to, for people."""

    async def open(self) -> None:
        """Get ready to send."""

    def send(self, data: bytes) -> None:
        """Send one datagram, line or sentence; never waits."""

    async def close(self) -> None:
        """Let go."""


class UdpLink:
    """Datagrams to one place, whether somebody listens or not."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp:{host}:{port}"
        self._where = host, port
        self._socket: socket.socket | None = None

    async def open(self) -> None:
        """Open a socket that may broadcast."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003 the socket's own argument
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, data: bytes) -> None:
        """Send a datagram; one that the network refuses is lost, as on any network."""
        assert self._socket is not None, "send before open"  # noqa: S101
        with suppress(OSError):
            self._socket.sendto(data, self._where)

    async def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


class TcpLink:
    """A server: everybody who connects gets everything from then on."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcp:{host}:{port}"
        self._where = host, port
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()

    async def open(self) -> None:
        """Listen.

        Raises:
            SonarSimError: the address cannot be listened on.
        """
        host, port = self._where
        try:
            self._server = await asyncio.start_server(self._serve, host, port)
        except OSError as error:
            reason = error.strerror or str(error)
            raise SonarSimError(f"odometry: cannot listen on {host}:{port}: {reason}") from error
        self.name = f"tcp:{host}:{self._server.sockets[0].getsockname()[1]}"

    def send(self, data: bytes) -> None:
        """Send to all; who does not read is let go."""
        for client in list(self._clients):
            if client.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
                client.transport.abort()
            else:
                client.write(data)

    async def close(self) -> None:
        """Close the server and its connections."""
        for client in self._clients:
            client.transport.abort()
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Keep a client until it disconnects; ignore what it sends."""
        self._clients.add(writer)
        try:
            with suppress(OSError):
                while await reader.read(1 << 12):
                    pass
        finally:
            self._clients.discard(writer)
            writer.close()


class SerialLink:
    """A serial line, or the end of a new pseudo-terminal where no path is given."""

    def __init__(self, path: Path | None) -> None:
        self.name = "pty" if path is None else f"serial:{path}"
        self._path = path
        self._handles: list[int] = []

    async def open(self) -> None:
        """Open the line; a pseudo-terminal's name is that of its other end.

        Raises:
            SonarSimError: the line cannot be opened.
        """
        if self._path is None:
            ours, theirs = pty.openpty()
            tty.setraw(theirs)
            self._handles = [ours, theirs]
            self.name = f"serial:{os.ttyname(theirs)}"
        else:
            try:
                self._handles = [os.open(self._path, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)]
            except OSError as error:
                raise SonarSimError(f"odometry: {self._path}: {error.strerror}") from error
        os.set_blocking(self._handles[0], False)

    def send(self, data: bytes) -> None:
        """Write; what nobody reads in time is lost, as on any serial line."""
        with suppress(BlockingIOError):
            os.write(self._handles[0], data)

    async def close(self) -> None:
        """Close the line."""
        for handle in self._handles:
            os.close(handle)
        self._handles = []


def link_named(text: str) -> OdometryOutlet:
    """A link from `udp:HOST:PORT`, `tcp:HOST:PORT`, `serial:PATH` or `pty`.

    Raises:
        SonarSimError: the text is not a link.
    """
    kind, _, where = text.partition(":")
    if text == "pty":
        return SerialLink(None)
    if kind == "serial" and where:
        return SerialLink(Path(where))
    host, _, port = where.rpartition(":")
    if kind in ("udp", "tcp") and host and port.isdecimal() and int(port) < 1 << 16:
        return UdpLink(host, int(port)) if kind == "udp" else TcpLink(host, int(port))
    raise SonarSimError(
        f"odometry: {text!r} is not a link; use udp:HOST:PORT, tcp:HOST:PORT, serial:PATH or pty"
    )
