"""The map stream of a daemon, with asyncio: connects, stays connected, mirrors the map."""

import asyncio
import contextlib
import dataclasses
import ssl
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping
from types import TracebackType
from typing import Any, Self

from mapperd.client.change_queue import ChangeQueue
from mapperd.client.changes import ClientChange, LinkChanged, LinkState, LinkStatus
from mapperd.client.connect import (
    RetryDelay,
    daemon_address,
    opened,
    read,
    reason_of,
    send,
    with_hint,
)
from mapperd.client.errors import AskError, EndedError
from mapperd.client.protocol import ClientProtocol, StreamOptions
from mapperd.client.state import MAX_BLOCKS, ClientState, StateReader
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import AnswerMessage, Interest, Want

__all__ = ["DEFAULT_WANTS", "MapClient", "PendingRequests"]

UNDER_WAY = 8
"""A daemon cuts off who asks more at once."""


class PendingRequests:
    """Each request of one client, from its number to its answer.

    Attributes:
        turn: held by each; more than a daemon takes wait for it.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Semaphore(UNDER_WAY)
        self._number = 0
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}

    def begin(self) -> tuple[int, "asyncio.Future[dict[str, Any]]"]:
        """A number for a request, and what its answer will be."""
        self._number += 1
        answer = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        return self._number, answer

    def end(self, number: int) -> None:
        """Nobody waits for it any more."""
        self._waiting.pop(number, None)

    def answered(self, answer: AnswerMessage) -> None:
        """Give an answer to who waits for it; one that nobody waits for is passed over."""
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
        """The connection is gone, and with it all answers; some requests may have been obeyed."""
        waiting, self._waiting = self._waiting, {}
        for answer in waiting.values():
            if not answer.done():
                what = "the connection broke before the answer; it may have been done"
                answer.set_exception(AskError("link_lost", what))


DEFAULT_WANTS: tuple[Want, ...] = ("map", "pose", "path", "fan")


class MapClient(StateReader):
    """A client of one daemon's map stream, `async with`; it tries for ever to be connected.

    Args:
        address: "" for the daemon of this computer, the path of a Unix socket, or `host:port`.
        token: that a TCP socket asks for.
        tls: encrypts TCP.
        wants: kinds of messages.
        interest: in the map.
        bytes_per_s: at most; 0 leaves it to the link.
        name: of the program, for people.
        most_blocks: that the mirror may hold, of 512 cells each.

    Raises:
        ValueError: no address, or nothing that can be wanted.
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
        self._link = LinkStatus("connecting", str(self._place), "", time.monotonic())
        self._retry = RetryDelay()

    @property
    def link(self) -> LinkStatus:
        """How the connection is."""
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
        """Hang up; who iterates over changes comes to their end."""
        if self._running is not None:
            self._running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._running

    async def changes(self) -> AsyncIterator[ClientChange]:
        """What happens, from now on; first all that is known already.

        A reader that is slow is sent less, and newer things; it costs bounded memory. There may be
        several.

        Raises:
            StreamError: the daemon will not have us, or what answers is none.
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
        """For one who takes changes in another way; `news` is called where there are some."""
        pending = ChangeQueue(self._client_state, LinkChanged(self.link), news)
        self._readers.add(pending)
        try:
            yield pending
        finally:
            self._readers.discard(pending)

    async def complete(self, timeout_s: float | None = None) -> None:
        """Wait until all of the interest in the map is here as the daemon has it now.

        Raises:
            TimeoutError: it is not.
            StreamError: as `changes`.
        """
        async with asyncio.timeout(timeout_s):
            while not self._client_state.is_complete:
                self.raise_error()
                if self._link.state == "closed":
                    raise EndedError("this client hung up", "closed")
                await self._news.wait()

    async def ask(self, do: str, *, timeout_s: float = 60.0, **fields: Any) -> dict[str, Any]:  # noqa: ANN401 plain values
        """Make a request of docs/reference/control.md; returns its result.

        Raises:
            AskError: it was not done.
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
        """Change settings of the daemon, all or none; returns name to values before and after.

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
        """Wish for something else, now and after the next connection; what is None stays.

        Raises:
            ValueError: there is no such thing to be wanted.
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
                self._set_link("closed", "hung up")

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
            await self._retry.wait(time.monotonic() - began_s)

    async def _connection(self) -> str:
        """One connection from its beginning to its end; returns why it ended.

        Raises:
            StreamError: because of what the daemon said.
        """
        try:
            reader, writer = await opened(self._place, self._tls)
        except OSError as error:
            return reason_of(error)
        self._writer = writer
        self._protocol.begin()
        reason = "the daemon hung up"
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
            # A read of bytes that are there already does not let others have their turn.
            await asyncio.sleep(0)

    def _send(self) -> None:
        if self._writer is not None:
            send(self._writer, self._protocol)

    def _invalidate(self) -> None:
        """The daemon said what it may not."""
        self._faults += 1
        self._client_state.invalidate()

    def _set_link(self, state: LinkState, reason: str) -> None:
        self._link = LinkStatus(state, str(self._place), reason, time.monotonic(), self._connects)
        self._publish(LinkChanged(self.link))

    def _publish(self, change: ClientChange) -> None:
        for reader in self._readers:
            reader.add(change)
        news, self._news = self._news, asyncio.Event()
        news.set()

    def raise_error(self) -> None:
        """Why there is no connection any more, if that is no wish of ours.

        Raises:
            StreamError: that is why.
        """
        if self._error is not None:
            raise self._error
        if self._running is not None and self._running.done() and not self._running.cancelled():
            self._running.result()
