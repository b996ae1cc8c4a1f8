"""The map stream of a daemon, with asyncio: connects, stays connected, and mirrors the map."""

import asyncio
import contextlib
import dataclasses
import random
import ssl
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping
from types import TracebackType
from typing import Any, Self

from mapperd.client.address import place_of
from mapperd.client.asking import Asking
from mapperd.client.changes import ClientChange, LinkChanged, LinkState, LinkStatus
from mapperd.client.connecting import opened, reason_of, with_hint
from mapperd.client.dialogue import Dialogue, Wishes
from mapperd.client.errors import AskError, EndedError
from mapperd.client.knowledge import MOST_BLOCKS, Knowledge
from mapperd.client.known import Known
from mapperd.client.pending import Pending
from mapperd.stream.framing import StreamError
from mapperd.stream.messages import Interest, Want

__all__ = ["DEFAULT_WANTS", "MapClient"]

DEFAULT_WANTS: tuple[Want, ...] = ("map", "pose", "path", "fan")

READ_BYTES = 1 << 16
CONNECT_S = 10.0
SILENCE_S = 6.0
"""The daemon says something once a second."""

WAIT_S, LONGEST_WAIT_S = 0.2, 5.0
SOUND_S = 2.0
"""A connection that lasted as long was a good one: the next attempt comes soon."""

UNSENT_BYTES = 1 << 16
"""Of a daemon that does not read; no more is acknowledged to it meanwhile."""


class MapClient(Known):
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
        most_blocks: int = MOST_BLOCKS,
    ) -> None:
        self._place = place_of(address)
        self._tls = tls
        self._asking = Asking()
        wishes = Wishes(tuple(wants), interest or Interest(), bytes_per_s, name)
        self._knowledge = Knowledge(wishes.interest, self._tell, most_blocks)
        self._dialogue = Dialogue(wishes, self._knowledge, token, self._asking.answered)
        self._readers: set[Pending] = set()
        self._news = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._running: asyncio.Task[None] | None = None
        self._error: StreamError | None = None
        self._bytes = self._connects = self._faults = 0
        self._link = LinkStatus("connecting", str(self._place), "", time.monotonic())
        self._jitter = random.Random()  # noqa: S311 no secret
        self._wait_s = WAIT_S

    @property
    def link(self) -> LinkStatus:
        """How the connection is."""
        return dataclasses.replace(self._link, bytes=self._bytes)

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

        A reader that is slow is told less, and newer things; it costs bounded memory. There may be
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
    def reader(self, news: Callable[[], None] = lambda: None) -> Iterator[Pending]:
        """For one who takes changes in another way; `news` is called where there are some."""
        pending = Pending(self._knowledge, LinkChanged(self.link), news)
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
            while not self._knowledge.is_complete:
                self.raise_error()
                if self._link.state == "closed":
                    raise EndedError("this client hung up", "closed")
                await self._news.wait()

    async def ask(self, do: str, *, timeout_s: float = 60.0, **fields: Any) -> dict[str, Any]:  # noqa: ANN401 plain values
        """Make a request of docs/control.md; returns its result.

        Raises:
            AskError: it was not done.
        """
        try:
            async with asyncio.timeout(timeout_s), self._asking.turn:
                return await self._asked(do, fields)
        except TimeoutError as error:
            raise AskError("no_answer", f"no answer within {timeout_s:g} s") from error

    async def _asked(self, do: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        if not self._dialogue.is_welcome:
            raise AskError("not_connected", f"not connected to {self._place}: {self._link.reason}")
        number, answer = self._asking.begin()
        try:
            self._dialogue.ask(number, do, fields)
            self._send()
            return await answer
        finally:
            self._asking.end(number)

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
        before = self._dialogue.wishes
        self._dialogue.change(
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
                self._be("closed", "hung up")

    async def _stay_connected(self) -> None:
        while True:
            self._be("connecting", "")
            began_s = time.monotonic()
            try:
                reason = await self._connection()
            except StreamError as error:
                if isinstance(error, EndedError) and error.is_final:
                    self._error = error
                    self._be("closed", str(error))
                    return
                reason = str(error)
            if time.monotonic() - began_s > SOUND_S:
                self._wait_s = WAIT_S
            self._be("waiting", reason)
            await asyncio.sleep(self._wait_s * self._jitter.uniform(0.5, 1.0))
            self._wait_s = min(LONGEST_WAIT_S, 2 * self._wait_s)

    async def _connection(self) -> str:
        """One connection from its beginning to its end; returns why it ended.

        Raises:
            StreamError: because of what the daemon said.
        """
        try:
            async with asyncio.timeout(CONNECT_S):
                reader, writer = await opened(self._place, self._tls)
        except TimeoutError:
            return "nobody answers"
        except OSError as error:
            return reason_of(error)
        self._writer = writer
        self._dialogue.begin()
        reason = "the daemon hung up"
        try:
            await self._converse(reader)
        except OSError as error:
            reason = reason_of(error)
        except StreamError as error:
            if not isinstance(error, EndedError):
                self._faults += 1
                self._knowledge.distrust()
            raise
        finally:
            self._writer = None
            self._dialogue.end()
            self._asking.lose_all()
            writer.transport.abort()
        return with_hint(reason, self._place, self._tls, is_greeted=self._dialogue.is_greeted)

    async def _converse(self, reader: asyncio.StreamReader) -> None:
        while True:
            try:
                async with asyncio.timeout(SILENCE_S):
                    data = await reader.read(READ_BYTES)
            except TimeoutError as error:
                raise ConnectionError(f"nothing was heard for {SILENCE_S:g} s") from error
            if not data:
                return
            self._bytes += len(data)
            try:
                self._dialogue.receive(data)
            finally:
                if self._dialogue.is_welcome and self._link.state != "connected":
                    self._connects += 1
                    self._be("connected", "")
            self._send()
            # A read of bytes that are there already does not let others have their turn.
            await asyncio.sleep(0)

    def _send(self) -> None:
        writer = self._writer
        if writer is None or writer.is_closing():
            return
        is_read = writer.transport.get_write_buffer_size() < UNSENT_BYTES
        if said := self._dialogue.outgoing(acknowledge=is_read):
            writer.write(said)

    def _be(self, state: LinkState, reason: str) -> None:
        self._link = LinkStatus(
            state, str(self._place), reason, time.monotonic(), self._connects, 0, self._faults
        )
        self._tell(LinkChanged(self.link))

    def _tell(self, change: ClientChange) -> None:
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
