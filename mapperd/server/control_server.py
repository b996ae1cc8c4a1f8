"""Lets clients in, through every door, without letting them be a burden to each other."""

import asyncio
import contextlib
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Any, Self

from mapperd.api import DaemonApi
from mapperd.events import Event, Severity
from mapperd.server.control_session import Client, CutError, Surroundings
from mapperd.server.listeners import Listener, peer_of
from mapperd.wire.auth import FailureLimiter, Limits, TokenBucket

__all__ = ["ControlServer"]

BREATH_S = 1.0
"""Between attempts when the system has no more sockets to give."""


class ControlServer:
    """Serves the daemon's operations, `async with`, in the daemon's event loop.

    Args:
        operations: the daemon.
        doors: that it listens at; closed with the server.
        limits: what clients may take.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        operations: DaemonApi,
        doors: Sequence[Listener],
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._operations = operations
        self._doors = tuple(doors)
        self._limits = limits or Limits()
        self._clock = clock
        self._counters: Counter[str] = Counter()
        self._newcomers: dict[Listener, dict[Client, asyncio.Task[None]]] = {}
        self._clients: dict[Client, asyncio.Task[None]] = {}
        self._around = Surroundings(
            operations, self._limits, FailureLimiter(), self._count, self._admit, clock
        )
        self._waking = False
        self._open = AsyncExitStack()

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._open.callback(self._close_doors)
        self._open.push_async_callback(self._end)
        self._open.callback(self._operations.events.listen(self._hear))
        for door in self._doors:
            self._newcomers[door] = {}
            accepting = asyncio.create_task(self._accept(door))
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
        """Who is connected and what happened, in plain values."""
        return {
            "listening": [door.name for door in self._doors],
            "clients": len(self._clients),
            "newcomers": sum(map(len, self._newcomers.values())),
            "counters": dict(sorted(self._counters.items())),
        }

    async def _accept(self, door: Listener) -> None:
        connects = TokenBucket(self._limits.connects_per_s, self._limits.connects_at_once)
        while True:
            try:
                connection, address = await self._loop.sock_accept(door.socket)
            except OSError:  # no descriptors left, or it was gone before it was accepted
                self._counters["accepts_failed"] += 1
                await asyncio.sleep(BREATH_S)
                continue
            self._counters["accepted"] += 1
            self._take_in(door, connection, address)
            # At least one turn of the loop: accepting may not have waited for anything.
            await asyncio.sleep(connects.take(self._clock()))

    def _take_in(self, door: Listener, connection: socket.socket, address: object) -> None:
        peer, who = peer_of(connection, address)
        origin = f"control, {who}"
        client = Client(door, peer, origin, self._around)
        newcomers = self._newcomers[door]
        while len(newcomers) >= self._limits.newcomers:
            oldest = next(iter(newcomers))
            newcomers.pop(oldest).cancel()
            self._counters["cut_crowded_out"] += 1
        task = asyncio.create_task(client.serve(connection))
        newcomers[client] = task

        def ended(task: asyncio.Task[None]) -> None:
            newcomers.pop(client, None)
            self._clients.pop(client, None)
            if not client.is_begun:
                connection.close()
            if not task.cancelled() and (error := task.exception()) is not None:
                self._counters["failed"] += 1
                text = f"{origin}: {type(error).__name__}: {error}"
                self._operations.events.add(Severity.ERROR, "control_failed", text)

        task.add_done_callback(ended)

    def _count(self, what: str) -> None:
        self._counters[what] += 1

    def _admit(self, client: Client) -> None:
        if len(self._clients) >= self._limits.clients:
            raise CutError("refused_full")
        for newcomers in self._newcomers.values():
            if client in newcomers:
                self._clients[client] = newcomers.pop(client)

    def _hear(self, _: Event) -> None:
        """Any thread: wake those who follow the events, once for however many there are."""
        if not self._waking:
            self._waking = True
            with contextlib.suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._waking = False
        for client in self._clients:
            client.wake()

    async def _end(self) -> None:
        tasks = [*self._clients.values()]
        for newcomers in self._newcomers.values():
            tasks += newcomers.values()
        await _end_tasks(tasks)

    def _close_doors(self) -> None:
        for door in self._doors:
            door.close()


async def _end_tasks(tasks: Sequence["asyncio.Task[None]"]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
