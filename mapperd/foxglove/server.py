"""A WebSocket server for Foxglove and Lichtblick, fed by a client of the map stream."""

import asyncio
from collections.abc import AsyncIterator, Callable, Collection
from typing import Protocol

import foxglove
from foxglove.messages import LogLevel
from foxglove.websocket import Capability, StatusLevel, WebSocketServer

from mapperd.client.changes import ClientChange, LinkChanged, LinkStatus
from mapperd.errors import LiveError
from mapperd.foxglove.bridge import Relay
from mapperd.foxglove.channels import CHANNELS, Channels
from mapperd.foxglove.map_publisher import LIVE
from mapperd.foxglove.messages import Follows
from mapperd.foxglove.parameters import LiveParameters, Steers
from mapperd.wire.messages import WANTS, Settings, Want

__all__ = ["FIRST_WANTS", "Client", "serve"]

TICK_S = 0.1
BACKLOG = 128
"""Messages that wait for a viewer that reads slowly; then the oldest are left out."""

ON_DEMAND: tuple[Want, ...] = ("returns", "image", "localization")
"""Asked for only while somebody watches: they cost the link to the vehicle most."""

FIRST_WANTS: tuple[Want, ...] = tuple(want for want in WANTS if want not in ON_DEMAND)


class Client(Follows, Steers, Protocol):
    """A client of the map stream."""

    def changes(self) -> AsyncIterator[ClientChange]: ...  # noqa: D102
    async def change(self, *, wants: Collection[Want]) -> None: ...  # noqa: D102


async def serve(
    client: Client,
    host: str,
    port: int,
    ready: Callable[[int], None] = lambda _: None,
    *,
    may_change: bool = True,
) -> None:
    """Serve viewers until cancelled, or until the client is ended.

    Args:
        client: of the map stream, running.
        host: to listen on.
        port: 0 is any free one.
        ready: is told the port.
        may_change: viewers may change settings.

    Raises:
        LiveError: nobody can listen there.
        StreamError: the daemon will not have us.
    """
    context = foxglove.Context()
    service = _Service(client, Channels(context), may_change=may_change)
    try:
        server = foxglove.start_server(
            name="mapperd",
            host=host,
            port=port,
            capabilities=[Capability.Parameters, Capability.Time],
            server_listener=service.parameters,
            context=context,
            message_backlog_size=BACKLOG,
        )
    except (RuntimeError, OSError, ValueError) as error:
        raise LiveError(f"{host}:{port}: cannot be listened on: {error}") from error
    try:
        ready(server.port)
        await service.run(server)
    finally:
        # In a thread: a viewer's request in the midst of it waits for this loop.
        await asyncio.to_thread(server.stop)
        service.channels.close()


class _Service:
    """What goes from the client to the server, and back."""

    def __init__(self, client: Client, channels: Channels, *, may_change: bool) -> None:
        self.channels = channels
        loop = asyncio.get_running_loop()
        self.parameters = LiveParameters(
            client, loop, self._warn, self._watched, may_change=may_change
        )
        self._client = client
        self._relay = Relay(client, channels, LIVE, self._set_back)
        self._server: WebSocketServer | None = None
        self._wants = FIRST_WANTS
        self._time_ns = 0

    async def run(self, server: WebSocketServer) -> None:
        """Until the client is ended."""
        self._server = server
        ticking = asyncio.create_task(self._tick())
        try:
            async for change in self._client.changes():
                self._relay.take(change)
                if isinstance(change, Settings):
                    server.publish_parameter_values(self.parameters.note(change.facts))
                elif isinstance(change, LinkChanged):
                    self._tell_link(server, change.link)
                if ticking.done():
                    ticking.result()
        finally:
            ticking.cancel()
            await asyncio.wait((ticking,))

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._relay.tick(loop.time())
            if self._server is not None and self._relay.stamp_ns != self._time_ns:
                self._time_ns = self._relay.stamp_ns
                self._server.broadcast_time(self._time_ns)
            watched = {channel.want for channel in CHANNELS if self.channels.heard(channel.topic)}
            wants = tuple(want for want in WANTS if want in FIRST_WANTS or want in watched)
            if wants != self._wants:
                self._wants = wants
                await self._client.change(wants=wants)
            await asyncio.sleep(TICK_S)

    def _watched(self, topic: str) -> None:
        self._relay.renew(topic)

    def _warn(self, text: str) -> None:
        self._relay.log(LogLevel.Warning, "parameters", text)
        if self._server is not None:
            self._server.publish_status(text, StatusLevel.Warning)

    def _set_back(self) -> None:
        """Viewers forget what they know: it lies in the future now."""
        if self._server is not None:
            self._server.clear_session()

    def _tell_link(self, server: WebSocketServer, link: LinkStatus) -> None:
        """Where there is no time yet, a log cannot say it."""
        if link.state == "connected":
            server.remove_status(["connection"])
        else:
            text = f"{link.state}: {link.address} {link.reason}".strip()
            server.publish_status(text, StatusLevel.Warning, "connection")
