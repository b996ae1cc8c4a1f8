"""Serves clients: admits them, sends the live map and state, and answers their requests.

Twenty times a second the event loop encodes what is new, once, and sends each client what has room
on its link. One worker thread reads and encodes the map. So the daemon never waits for a client,
and no client waits for another.
"""

import asyncio
import secrets
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Any, Self

from mapperd.api import DaemonApi
from mapperd.events import Severity
from mapperd.server.connection import ClientConnection, ServerContext
from mapperd.server.listeners import Listener, peer_of
from mapperd.server.map_source import Source
from mapperd.server.map_worker import MapWorker
from mapperd.server.pacer import tune
from mapperd.server.session import ClientSession, Newcomer, SessionContext
from mapperd.server.state_feed import StateFeed
from mapperd.wire.auth import FailureLimiter, Limits, TokenBucket
from mapperd.wire.framing import StreamError

__all__ = ["StreamServer"]

TICK_S = 0.05
BEAT_S = 1.0
RETRY_DELAY_S = 1.0
"""Delay after `accept` failed, as when no file descriptors are left."""

LEAVE_S = 1.5
NEWCOMERS = 32
"""Maximum connections of one listener without a hello."""

MAX_LISTED = 20
"""Maximum clients in the status."""


class StreamServer:
    """Serves the map stream and requests in the daemon's event loop; an async context manager.

    Args:
        operations: the daemon.
        listeners: open sockets; closed with the server.
        feed: messages about the daemon's state.
        source: the map.
        limits: what clients may take; `clients` are those that follow the map.
        clock: seconds, monotonic.
        now_ns: Unix time that is never set back.
    """

    def __init__(
        self,
        operations: DaemonApi,
        listeners: Sequence[Listener],
        feed: StateFeed,
        source: Source,
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        config = operations.settings.current
        self._operations = operations
        self._listeners = tuple(listeners)
        self._feed = feed
        self._limits = limits or Limits(clients=config.server.max_clients, newcomers=NEWCOMERS)
        self._clock = clock
        self._counters: Counter[str] = Counter()
        self._clients: dict[ClientConnection, None] = {}
        self._newcomers: dict[Listener, dict[ClientConnection, asyncio.Task[None]]] = {}
        self._common = SessionContext(
            feed,
            operations.events,
            FailureLimiter(),
            config.mqtt.vehicle,
            config.stream.bytes_per_s,
        )
        self._context = ServerContext(
            operations,
            self._limits,
            self._count,
            self._admit,
            self._heard,
            self._refused,
            self._gone,
            clock,
            now_ns,
        )
        self._map_worker = MapWorker(operations, feed, source, self._clients, self._context)
        self._open = AsyncExitStack()

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._open.callback(self._close_listeners)
        self._open.push_async_callback(self._end)
        for work in (self._ticking(), self._map_worker.run()):
            task = asyncio.create_task(work)
            self._open.push_async_callback(_end_tasks, [task])
        for listener in self._listeners:
            self._newcomers[listener] = {}
            accepting = asyncio.create_task(self._accept(listener))
            self._open.push_async_callback(_end_tasks, [accepting])
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._open.aclose()

    def status(self) -> dict[str, Any]:
        """Return listeners, clients and counters as plain values; any thread may call it."""
        clients = [*self._clients]
        return {
            "listening": [listener.name for listener in self._listeners],
            "clients": len(clients),
            "newcomers": sum(map(len, self._newcomers.values())),
            "blocks_left": max((one.session.left for one in clients), default=0),
            "counters": dict(sorted(self._all_counters().items())),
            "watching": [
                {"name": one.session.name, "from": one.origin, **one.session.outbox.link()}
                for one in clients[:MAX_LISTED]
            ],
        }

    async def _ticking(self) -> None:
        beat_s = 0.0
        while True:
            await asyncio.sleep(TICK_S)
            now_s = self._clock()
            wanted: frozenset[str] = frozenset().union(*(c.session.wants for c in self._clients))
            try:
                self._feed.refresh(wanted, now_s)
                if "status" in wanted and now_s - beat_s >= BEAT_S:
                    beat_s = now_s
                    self._feed.make_status()
            except Exception as error:  # noqa: BLE001 an internal error must not end the stream
                self._failed(error)
            for client in [*self._clients]:
                try:
                    client.turn()
                except Exception as error:  # noqa: BLE001 nor an error with one client
                    self._failed(error)
                    client.abort()
            self._map_worker.wake()

    def _all_counters(self) -> dict[str, int]:
        """Return the counters of the server, of the feed and of the resume cache."""
        return {**self._counters, **self._feed.left_out, **self._map_worker.resume_cache.counters}

    async def _accept(self, listener: Listener) -> None:
        connects = TokenBucket(self._limits.connects_per_s, self._limits.connects_at_once)
        while True:
            try:
                connection, address = await self._loop.sock_accept(listener.socket)
            except OSError:  # no descriptors left, or the client has left already
                self._counters["accepts_failed"] += 1
                await asyncio.sleep(RETRY_DELAY_S)
                continue
            self._counters["accepted"] += 1
            try:
                self._take_in(listener, connection, address)
            except Exception as error:  # noqa: BLE001 later clients are accepted
                connection.close()
                self._failed(error)
            # Always yields to the event loop: `sock_accept` may not have.
            await asyncio.sleep(connects.take(self._clock()))

    def _take_in(self, listener: Listener, connection: socket.socket, address: object) -> None:
        peer, who = peer_of(connection, address)
        tune(connection)
        challenge = "" if listener.token is None else secrets.token_hex(16)
        may_change = listener.token is not None or connection.family == socket.AF_UNIX
        newcomer = Newcomer(peer, challenge, listener.token)
        session = ClientSession(self._common, newcomer, may_change=may_change)
        client = ClientConnection(session, f"control, {who}", self._context)
        newcomers = self._newcomers[listener]
        while len(newcomers) >= self._limits.newcomers:
            oldest = next(iter(newcomers))
            newcomers.pop(oldest).cancel()
            oldest.abort()
            self._counters["cut_crowded_out"] += 1
        newcomers[client] = asyncio.create_task(self._open_up(listener, client, connection))

    async def _open_up(
        self, listener: Listener, client: ClientConnection, connection: socket.socket
    ) -> None:
        """Create the transport of a socket, with TLS if the listener has it."""
        limit_s = self._limits.hello_s if listener.tls else None
        try:
            await self._loop.connect_accepted_socket(
                lambda: client,
                connection,
                ssl=listener.tls,
                ssl_handshake_timeout=limit_s,
                ssl_shutdown_timeout=LEAVE_S if listener.tls else None,
            )
        except OSError:  # of TLS as well
            self._counters["connections_lost"] += 1
            self._gone(client)
        except asyncio.CancelledError:
            connection.close()
            raise

    def _count(self, what: str) -> None:
        self._counters[what] += 1

    def _admit(self, client: ClientConnection) -> None:
        view_request = client.session.view_request
        if view_request is not None and view_request.resume is not None:
            self._take_over(view_request.resume.ticket, client)
        # Followers of the map must not keep out operators, who only send requests.
        follows = bool(client.session.wants)
        clients = sum(bool(other.session.wants) == follows for other in self._clients)
        if clients >= (self._limits.clients if follows else self._limits.operators):
            text = f"{clients} clients are connected, which is the maximum"
            raise StreamError(text, "too_many_clients")
        self._drop_newcomer(client)
        self._clients[client] = None

    def _take_over(self, ticket: str, newcomer: ClientConnection) -> None:
        """Drop the connection that a returning client replaces; its break may be unnoticed here."""
        for client in [*self._clients]:
            if client is not newcomer and client.session.is_known_by(ticket):
                self._gone(client)
                client.drop()

    def _heard(self, client: ClientConnection) -> None:
        session = client.session
        view_request = session.view_request
        if (
            view_request is not None
            and view_request.interest is None
            and session.state == "admitted"
        ):
            self._map_worker.welcome(client)
        elif view_request is not None or session.left:
            self._map_worker.wake()

    def _refused(self, client: ClientConnection, reason: str) -> None:
        if reason == "wrong_token":
            text = f"{client.origin} does not know the token"
            self._operations.events.add(Severity.WARNING, "stream_wrong_token", text)

    def _gone(self, client: ClientConnection) -> None:
        self._clients.pop(client, None)
        self._drop_newcomer(client)
        view, client.session.view = client.session.view, None
        if view is not None:
            self._map_worker.leave(view, client.resume_state())

    def _drop_newcomer(self, client: ClientConnection) -> None:
        for newcomers in self._newcomers.values():
            newcomers.pop(client, None)

    def _failed(self, error: Exception) -> None:
        self._counters["failed"] += 1
        text = f"map stream: {type(error).__name__}: {error}"
        self._operations.events.add(Severity.ERROR, "stream_failed", text)

    async def _end(self) -> None:
        """Send the last message to all clients, and wait a moment for them to leave."""
        tasks = [task for each in self._newcomers.values() for task in each.values()]
        everybody = [*self._clients, *(one for each in self._newcomers.values() for one in each)]
        for client in everybody:
            client.end("closing", "the daemon stops")
        await _end_tasks(tasks)
        until_s = self._clock() + LEAVE_S
        while self._clients and self._clock() < until_s:  # noqa: ASYNC110 once, at the end
            await asyncio.sleep(0.01)
        for client in everybody:
            client.abort()

    def _close_listeners(self) -> None:
        for listener in self._listeners:
            listener.close()


async def _end_tasks(tasks: Sequence["asyncio.Task[None]"]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
