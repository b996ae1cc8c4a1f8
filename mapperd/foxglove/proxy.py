"""A reverse proxy that admits viewers by origin and token.

The SDK's WebSocket server admits everyone who reaches its port, also pages of any site that a
browser on this computer shows. It therefore listens where no page can find it, behind this proxy.
"""

import asyncio
import contextlib
import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Self
from urllib.parse import parse_qs, urlsplit

from mapperd.errors import LiveError
from mapperd.server.listeners import peer_of
from mapperd.wire.auth import FailureLimiter

__all__ = ["ORIGINS", "ViewerAccess", "ViewerProxy", "hidden_host"]

ORIGINS = ("https://app.foxglove.dev", "file://")
"""Foxglove in the browser; the desktop programs of Foxglove and Lichtblick."""

MAX_VIEWERS, MAX_CONNECTIONS = 32, 128
MAX_HEAD_BYTES = 8192
HEAD_TIMEOUT_S = 5.0
CHUNK_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class ViewerAccess:
    """Who may watch.

    Attributes:
        origins: of pages whose connections are admitted; programs that send none are no browsers.
        token: viewers send it as `?token=`; None admits everyone who reaches the port.
        report: called with one line for each viewer that is refused.
    """

    origins: tuple[str, ...] = ORIGINS
    token: bytes | None = None
    report: Callable[[str], None] = lambda _: None


def hidden_host() -> str:
    """Return a random address of this computer, one of 16 million: pages cannot try them all."""
    first, second, third = (secrets.randbelow(254) + 1 for _ in range(3))
    return f"127.{first}.{second}.{third}"


class ViewerProxy:
    """Listens as long as it is entered, and passes admitted viewers on.

    Args:
        host: address to listen on.
        port: 0 chooses a free one.
        access: who may watch.

    Attributes:
        port: of the socket, while entered.
        target: address and port of the server behind; set it before the first await.
    """

    def __init__(self, host: str, port: int, access: ViewerAccess) -> None:
        self.port = port
        self.target = (hidden_host(), 0)
        self._host = host
        self._access = access
        self._server: asyncio.Server | None = None
        self._connections: set[asyncio.Task[None]] = set()
        self._viewers = 0
        self._failures = FailureLimiter()

    async def __aenter__(self) -> Self:
        """Listen.

        Raises:
            LiveError: cannot listen there.
        """
        where = f"{self._host}:{self.port}"
        try:
            self._server = await asyncio.start_server(
                self._serve, self._host, self.port, limit=MAX_HEAD_BYTES
            )
        except (OSError, OverflowError) as error:
            raise LiveError(f"{where}: cannot listen: {error}") from error
        self.port = int(self._server.sockets[0].getsockname()[1])
        return self

    async def __aexit__(self, *_: object) -> None:
        """Stop listening and cut all connections."""
        if self._server is not None:
            self._server.close()
        connections = tuple(self._connections)
        for connection in connections:
            connection.cancel()
        await asyncio.gather(*connections, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection to its end."""
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 asyncio starts one for each connection
        if len(self._connections) >= MAX_CONNECTIONS:
            writer.transport.abort()
            return
        self._connections.add(task)
        try:
            with contextlib.suppress(OSError, EOFError, asyncio.LimitOverrunError):
                await self._admit(reader, writer)
        except asyncio.CancelledError:
            writer.transport.abort()
        finally:
            self._connections.discard(task)
            writer.close()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        _, peer = peer_of(writer.get_extra_info("socket"), writer.get_extra_info("peername"))
        async with asyncio.timeout(HEAD_TIMEOUT_S):
            head = await reader.readuntil(b"\r\n\r\n")
        refusal = self._refusal(head, peer)
        if refusal is not None:
            status, why = refusal
            self._access.report(f"refused a viewer at {peer}: {why}")
            body = f"{why}\n".encode()
            writer.write(
                f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain\r\n"
                f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n".encode()
                + body
            )
            await writer.drain()
            return
        self._viewers += 1
        try:
            await self._pass_on(head, reader, writer)
        finally:
            self._viewers -= 1

    async def _pass_on(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Connect a viewer with the server behind, until one of them ends."""
        server_reader, server_writer = await asyncio.open_connection(*self.target)
        _, _, fields = head.partition(b"\r\n")
        with contextlib.closing(server_writer):  # also where the wait for the pumps is cancelled
            server_writer.write(b"GET / HTTP/1.1\r\n" + fields)  # without the token
            pumps = (
                asyncio.create_task(_pump(reader, server_writer)),
                asyncio.create_task(_pump(server_reader, writer)),
            )
            try:
                await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for pump in pumps:
                    pump.cancel()
                await asyncio.gather(*pumps, return_exceptions=True)

    def _refusal(self, head: bytes, peer: str) -> tuple[HTTPStatus, str] | None:
        """Return why a viewer is refused, with the status; None admits it."""
        request, *lines = head.decode("latin-1").split("\r\n")
        method, _, address = request.rpartition(" ")[0].partition(" ")
        fields = [line.partition(":") for line in lines if line]
        values = [(name.strip().lower(), value.strip().lower()) for name, _, value in fields]
        if method != "GET" or ("upgrade", "websocket") not in values:
            return HTTPStatus.BAD_REQUEST, "this is a WebSocket server for Foxglove and Lichtblick"
        for name, origin in values:
            if name == "origin" and origin not in self._access.origins:
                shown = ascii(origin[:100])[1:-1]
                return (
                    HTTPStatus.FORBIDDEN,
                    f"page of another origin; to admit it: --allow-origin {shown}",
                )
        if self._viewers >= MAX_VIEWERS:
            return HTTPStatus.SERVICE_UNAVAILABLE, "too many viewers"
        return self._token_refusal(address, peer)

    def _token_refusal(self, address: str, peer: str) -> tuple[HTTPStatus, str] | None:
        if self._access.token is None:
            return None
        if self._failures.wait_s(peer, time.monotonic()) > 0:
            return HTTPStatus.TOO_MANY_REQUESTS, "too many wrong tokens; wait ten seconds"
        given = parse_qs(urlsplit(address).query).get("token", [""])[-1]
        if not given:
            return HTTPStatus.UNAUTHORIZED, "a token is needed: add ?token=TOKEN to the address"
        if not hmac.compare_digest(given.encode(), self._access.token):
            self._failures.failed(peer, time.monotonic())
            return HTTPStatus.UNAUTHORIZED, "wrong token; see --viewer-token-file"
        return None


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass bytes on until the sender ends; a slow receiver slows the sender."""
    while data := await reader.read(CHUNK_BYTES):
        writer.write(data)
        await writer.drain()
