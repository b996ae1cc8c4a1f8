"""A WebSocket server for Foxglove and Lichtblick, fed by a client of the map stream.

It also offers the daemon's live settings as Foxglove parameters, both ways.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from typing import Any, Protocol

import foxglove
from foxglove.messages import LogLevel
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    Parameter,
    ServerListener,
    StatusLevel,
    WebSocketServer,
)

from mapperd.client.changes import ClientChange, ConnectionStatus, LinkChanged
from mapperd.client.validation import AskError
from mapperd.errors import LiveError
from mapperd.foxglove.bridge import FoxgloveRelay
from mapperd.foxglove.channels import CHANNELS, Channels
from mapperd.foxglove.map_publisher import LIVE
from mapperd.foxglove.messages import Follows
from mapperd.foxglove.proxy import ViewerAccess, ViewerProxy
from mapperd.wire.messages import WANTS, SettingsMessage, Want

__all__ = ["FIRST_WANTS", "FoxgloveClient", "LiveParameters", "Steers", "serve"]

ANSWER_TIMEOUT_S = 10.0
"""Timeout of a viewer's request to set parameters."""


class Steers(Protocol):
    """The settings side of a map stream client."""

    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102
    async def set(self, changes: Mapping[str, Any]) -> Mapping[str, Any]: ...  # noqa: D102


class LiveParameters(ServerListener):
    """Answers viewers in the server's threads.

    Args:
        client: client of the map stream.
        loop: event loop of the client.
        warn: called in the loop with the reason of a refusal.
        watched: called in the loop with a topic that got a subscriber.
        may_change: viewers may set parameters.
    """

    def __init__(
        self,
        client: Steers,
        loop: asyncio.AbstractEventLoop,
        warn: Callable[[str], None],
        watched: Callable[[str], None],
        *,
        may_change: bool,
    ) -> None:
        self._client = client
        self._loop = loop
        self._warn = warn
        self._watched = watched
        self._may_change = may_change
        self._values: dict[str, Any] = {}

    def note(self, facts: Mapping[str, Any]) -> list[Parameter]:
        """Update the values from the daemon; return the live settings among them."""
        live = {
            name: fact["value"]
            for name, fact in facts.items()
            if fact.get("dynamic") and fact.get("value") is not None
        }
        self._values = {**self._values, **live}
        return _parameters(live)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        """Report a new subscriber."""
        self._loop.call_soon_threadsafe(self._watched, channel.topic)

    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Return the parameters of these names, or all."""
        return self._now(param_names)

    def on_set_parameters(
        self,
        client: Client,  # noqa: ARG002
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Set all or none; return the values in force afterwards."""
        changes = {one.name: one.get_value() for one in parameters}
        done = asyncio.run_coroutine_threadsafe(self._set(changes), self._loop)
        try:
            done.result(ANSWER_TIMEOUT_S)
        except TimeoutError:
            done.cancel()
            self._loop.call_soon_threadsafe(self._warn, f"{_names(changes)}: no answer")
        return self._now(list(changes))

    async def _set(self, changes: dict[str, Any]) -> None:
        """In the client's loop."""
        if not self._may_change:
            self._warn(
                f"{_names(changes)}: viewers may not change settings; start with --allow-changes"
            )
            return
        unknown = changes.keys() - self._values.keys()
        if unknown:
            self._warn(f"{_names(unknown)}: not a live setting of the daemon")
            return
        try:
            changed = await self._client.set(
                {name: _like(self._values[name], value) for name, value in changes.items()}
            )
        except AskError as error:
            text = str(error)
            named = any(name in text for name in changes)
            self._warn(text if named else f"{_names(changes)}: {text}")
            return
        self._values = {**self._values, **{name: after for name, (_, after) in changed.items()}}

    def _now(self, names: list[str]) -> list[Parameter]:
        values = self._values
        return _parameters(
            {name: values[name] for name in names or sorted(values) if name in values}
        )


def _parameters(values: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def _like(before: object, value: Any) -> Any:  # noqa: ANN401 plain values
    """Convert a whole float to int where the setting is an int: JSON has one kind of number."""
    whole = isinstance(before, int) and not isinstance(before, bool)
    if whole and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _names(names: Any) -> str:  # noqa: ANN401 any collection of them
    return ", ".join(sorted(names))


TICK_S = 0.1
BACKLOG = 128
"""Messages queued for a slow viewer; beyond that the oldest are dropped."""

ON_DEMAND: tuple[Want, ...] = ("returns", "image", "localization")
"""Requested only while someone subscribes, because they cost most bandwidth."""

FIRST_WANTS: tuple[Want, ...] = tuple(want for want in WANTS if want not in ON_DEMAND)


class FoxgloveClient(Follows, Steers, Protocol):
    """A client of the map stream."""

    def changes(self) -> AsyncIterator[ClientChange]: ...  # noqa: D102
    async def change(self, *, wants: Collection[Want]) -> None: ...  # noqa: D102


async def serve(
    client: FoxgloveClient,
    host: str,
    port: int,
    ready: Callable[[int], None] = lambda _: None,
    *,
    access: ViewerAccess | None = None,
    may_change: bool = True,
) -> None:
    """Serve viewers until cancelled, or until the client ends.

    Args:
        client: running client of the map stream.
        host: address to listen on.
        port: 0 chooses a free one.
        ready: called with the port.
        access: who may watch; None admits known viewers without a token.
        may_change: viewers may change settings.

    Raises:
        LiveError: cannot listen there.
        StreamError: the daemon refuses the client.
    """
    context = foxglove.Context()
    service = _Service(client, Channels(context), may_change=may_change)
    try:
        async with ViewerProxy(host, port, access or ViewerAccess()) as proxy:
            server = _start(service, context, proxy.target[0])
            proxy.target = (proxy.target[0], server.port)
            try:
                ready(proxy.port)
                await service.run(server)
            finally:
                # In a thread, because a pending request of a viewer waits for this loop.
                await asyncio.to_thread(server.stop)
    finally:
        service.channels.close()


def _start(service: "_Service", context: foxglove.Context, host: str) -> WebSocketServer:
    """Start the SDK's server at a free port.

    Raises:
        LiveError: cannot listen there.
    """
    try:
        return foxglove.start_server(
            name="mapperd",
            host=host,
            port=0,
            capabilities=[Capability.Parameters, Capability.Time],
            server_listener=service.parameters,
            context=context,
            message_backlog_size=BACKLOG,
        )
    except (RuntimeError, OSError, ValueError) as error:
        raise LiveError(f"{host}: cannot listen: {error}") from error


class _Service:
    """Passes changes from the client to the server, and requests back."""

    def __init__(self, client: FoxgloveClient, channels: Channels, *, may_change: bool) -> None:
        self.channels = channels
        loop = asyncio.get_running_loop()
        self.parameters = LiveParameters(
            client, loop, self._warn, self._watched, may_change=may_change
        )
        self._client = client
        self._relay = FoxgloveRelay(client, channels, LIVE, self._set_back)
        self._server: WebSocketServer | None = None
        self._wants = FIRST_WANTS
        self._time_ns = 0

    async def run(self, server: WebSocketServer) -> None:
        """Run until the client ends."""
        self._server = server
        ticking = asyncio.create_task(self._tick())
        try:
            async for change in self._client.changes():
                self._relay.take(change)
                if isinstance(change, SettingsMessage):
                    server.publish_parameter_values(self.parameters.note(change.facts))
                elif isinstance(change, LinkChanged):
                    self._publish_link(server, change.link)
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
        """Have viewers discard their data, which now lies in the future."""
        if self._server is not None:
            self._server.clear_session()

    def _publish_link(self, server: WebSocketServer, link: ConnectionStatus) -> None:
        """Publish the connection's state as a status, which needs no time stamp."""
        if link.state == "connected":
            server.remove_status(["connection"])
        else:
            text = f"{link.state}: {link.address} {link.reason}".strip()
            server.publish_status(text, StatusLevel.Warning, "connection")
