"""Client of a daemon's map stream for asyncio: connects, reconnects, mirrors the map."""

import asyncio
import contextlib
import dataclasses
import random
import ssl
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping
from types import TracebackType
from typing import Any, Self

from mapperd.client.change_queue import ChangeQueue
from mapperd.client.changes import ClientChange, ConnectionStatus, LinkChanged, LinkState
from mapperd.client.connect import (
    daemon_address,
    opened,
    read,
    reason_of,
    send,
    with_hint,
)
from mapperd.client.protocol import ClientProtocol, StreamOptions
from mapperd.client.state import MAX_BLOCKS, ClientState, StateReader
from mapperd.client.validation import AskError, EndedError
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import AnswerMessage, Interest, Want
from oculus_driver.back_off import BackOff, doubling_steps

__all__ = ["DEFAULT_WANTS", "MapClient", "PendingRequests"]

RETRY_DELAY_S, MAX_RETRY_DELAY_S = 0.2, 5.0
SOUND_S = 2.0
"""A connection that lasted this long was good: the next attempt follows soon."""

UNDER_WAY = 8
"""Maximum requests at once; a daemon disconnects clients with more."""


class PendingRequests:
    """Requests of one client that wait for their answers.

    Attributes:
        turn: semaphore that each request holds; others wait for it.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Semaphore(UNDER_WAY)
        self._number = 0
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}

    def begin(self) -> tuple[int, "asyncio.Future[dict[str, Any]]"]:
        """Return a number for a request, and the future of its answer."""
        self._number += 1
        answer = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        return self._number, answer

    def end(self, number: int) -> None:
        """Forget a request."""
        self._waiting.pop(number, None)

    def answered(self, answer: AnswerMessage) -> None:
        """Set the result of the request that an answer is for, if it waits."""
        waiting = self._waiting.pop(answer.id, None) if answer.id is not None else None
        if waiting is None or waiting.done():
            return
        if answer.error is None:
            waiting.set_result(answer.result or {})
            return
        reason = str(answer.error.get("reason", "failed"))
        details = answer.error.get("details")
        waiting.set_exception(
            AskError(
                reason,
                str(answer.error.get("message", reason)),
                details if isinstance(details, dict) else None,
            )
        )

    def lose_all(self) -> None:
        """Fail all requests: the connection broke. Some may have been carried out."""
        waiting, self._waiting = self._waiting, {}
        for answer in waiting.values():
            if not answer.done():
                what = (
                    "the connection broke before the answer; the request may have been carried out"
                )
                answer.set_exception(AskError("link_lost", what))


DEFAULT_WANTS: tuple[Want, ...] = ("map", "pose", "path", "fan")


class MapClient(StateReader):
    """Client of one daemon's map stream; an async context manager that stays connected.

    Args:
        address: "" for the local daemon, the path of a Unix socket, or `host:port`.
        token: for a TCP address that requires one.
        tls: encrypts TCP.
        wants: kinds of messages.
        interest: part of the map; None is all of it.
        bytes_per_s: limit of the rate; 0 has no limit.
        name: of the program, for people.
        most_blocks: maximum blocks of the mirror, of 512 cells each.

    Raises:
        ValueError: the address or a kind of messages is unknown, or a value is not allowed.
    """

    def __init__(
        self,
        address: str = "",
        *,
        token: bytes | None = None,
        tls: ssl.SSLContext | None = None,
        wants: Collection[Want] = DEFAULT_WANTS,
        interest: Interest | None = None,
        bytes_per_s: int = 0,
        name: str = "",
        most_blocks: int = MAX_BLOCKS,
    ) -> None:
        self._place = daemon_address(address)
        self._tls = tls
        self._requests = PendingRequests()
        options = StreamOptions(tuple(wants), interest or Interest(), bytes_per_s, name)
        self._client_state = ClientState(options.interest, self._publish, most_blocks)
        self._protocol = ClientProtocol(options, self._client_state, token, self._requests.answered)
        self._readers: set[ChangeQueue] = set()
        self._news = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._running: asyncio.Task[None] | None = None
        self._error: StreamError | None = None
        self._bytes = self._connects = self._faults = 0
        self._link = ConnectionStatus("connecting", str(self._place), "", time.monotonic())
        self._back_off = BackOff(doubling_steps(RETRY_DELAY_S, MAX_RETRY_DELAY_S), random.random)

    @property
    def link(self) -> ConnectionStatus:
        """State of the connection."""
        return dataclasses.replace(self._link, bytes=self._bytes, faults=self._faults)

    async def __aenter__(self) -> Self:
        self._running = asyncio.create_task(self._run())
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect; iterators over changes end."""
        if self._running is not None:
            self._running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._running

    async def changes(self) -> AsyncIterator[ClientChange]:
        """Iterate over changes; the first ones are the state that is known already.

        A slow reader gets merged and newer changes, in bounded memory. Several readers are
        allowed.

        Raises:
            StreamError: the daemon refuses this client, or the server is not a daemon.
        """
        with self.reader() as pending:
            while True:
                news = self._news
                while (change := pending.take()) is not None:
                    yield change
                if self._link.state == "closed":
                    self.raise_error()
                    return
                await news.wait()

    @contextlib.contextmanager
    def reader(self, news: Callable[[], None] = lambda: None) -> Iterator[ChangeQueue]:
        """Yield a queue of changes; `news` is called after a change was added."""
        pending = ChangeQueue(self._client_state, LinkChanged(self.link), news)
        self._readers.add(pending)
        try:
            yield pending
        finally:
            self._readers.discard(pending)

    async def complete(self, timeout_s: float | None = None) -> None:
        """Wait until the mirror has all of the interest, up to date.

        Raises:
            TimeoutError: the time is over.
            StreamError: as `changes`.
        """
        async with asyncio.timeout(timeout_s):
            while not self._client_state.is_complete:
                self.raise_error()
                if self._link.state == "closed":
                    raise EndedError("this client has closed", "closed")
                await self._news.wait()

    async def ask(self, do: str, *, timeout_s: float = 60.0, **fields: Any) -> dict[str, Any]:  # noqa: ANN401 plain values
        """Make a request of docs/reference/control.md; return its result.

        Raises:
            AskError: the request was not carried out.
        """
        try:
            async with asyncio.timeout(timeout_s), self._requests.turn:
                return await self._asked(do, fields)
        except TimeoutError as error:
            raise AskError("no_answer", f"no answer within {timeout_s:g} s") from error

    async def _asked(self, do: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        if not self._protocol.is_welcome:
            raise AskError("not_connected", f"not connected to {self._place}: {self._link.reason}")
        number, answer = self._requests.begin()
        try:
            self._protocol.ask(number, do, fields)
            self._send()
            return await answer
        finally:
            self._requests.end(number)

    async def set(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Change settings of the daemon, all or none; return name to values before and after.

        Raises:
            AskError: nothing was changed; `details` has the reasons by name.
        """
        changed = (await self.ask("set", changes=dict(changes))).get("changed", {})
        return changed if isinstance(changed, dict) else {}

    async def change(
        self,
        *,
        wants: Collection[Want] | None = None,
        interest: Interest | None = None,
        bytes_per_s: int | None = None,
    ) -> None:
        """Change options, for this connection and later ones; None keeps an option.

        Raises:
            ValueError: a value is not allowed.
        """
        before = self._protocol.options
        self._protocol.change(
            dataclasses.replace(
                before,
                wants=before.wants if wants is None else tuple(wants),
                interest=before.interest if interest is None else interest,
                bytes_per_s=before.bytes_per_s if bytes_per_s is None else bytes_per_s,
            )
        )
        self._send()

    async def _run(self) -> None:
        try:
            await self._stay_connected()
        finally:
            if self._link.state != "closed":
                self._set_link("closed", "closed by this program")

    async def _stay_connected(self) -> None:
        while True:
            self._set_link("connecting", "")
            began_s = time.monotonic()
            try:
                reason = await self._connection()
            except StreamError as error:
                if isinstance(error, EndedError) and error.is_final:
                    self._error = error
                    self._set_link("closed", str(error))
                    return
                reason = str(error)
            self._set_link("waiting", reason)
            if time.monotonic() - began_s > SOUND_S:
                self._back_off.succeeded()
            await asyncio.sleep(self._back_off.failed())

    async def _connection(self) -> str:
        """Run one connection to its end; return why it ended.

        Raises:
            StreamError: the daemon ended it or broke the protocol.
        """
        try:
            reader, writer = await opened(self._place, self._tls)
        except OSError as error:
            return reason_of(error)
        self._writer = writer
        self._protocol.begin()
        reason = "the daemon closed the connection"
        try:
            await self._converse(reader)
        except OSError as error:
            reason = reason_of(error)
        except StreamError as error:
            if not isinstance(error, EndedError):
                self._invalidate()
            raise
        finally:
            self._writer = None
            self._protocol.end()
            self._requests.lose_all()
            writer.transport.abort()
        return with_hint(reason, self._place, self._tls, is_greeted=self._protocol.is_greeted)

    async def _converse(self, reader: asyncio.StreamReader) -> None:
        while data := await read(reader):
            self._bytes += len(data)
            try:
                self._protocol.receive(data)
            finally:
                if self._protocol.is_welcome and self._link.state != "connected":
                    self._connects += 1
                    self._set_link("connected", "")
            self._send()
            # Yields to the event loop: a read of bytes that have arrived does not.
            await asyncio.sleep(0)

    def _send(self) -> None:
        if self._writer is not None:
            send(self._writer, self._protocol)

    def _invalidate(self) -> None:
        """Count a fault of the daemon, and do not resume from this state."""
        self._faults += 1
        self._client_state.invalidate()

    def _set_link(self, state: LinkState, reason: str) -> None:
        self._link = ConnectionStatus(
            state, str(self._place), reason, time.monotonic(), self._connects
        )
        self._publish(LinkChanged(self.link))

    def _publish(self, change: ClientChange) -> None:
        for reader in self._readers:
            reader.add(change)
        news, self._news = self._news, asyncio.Event()
        news.set()

    def raise_error(self) -> None:
        """Raise the error that ended the client, if there is one.

        Raises:
            StreamError: of the last connection.
        """
        if self._error is not None:
            raise self._error
        if self._running is not None and self._running.done() and not self._running.cancelled():
            self._running.result()
