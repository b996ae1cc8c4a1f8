"""One client's connection to the control socket: lines in, answers out."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

from mapperd.api import DaemonApi
from mapperd.events import Event, Severity
from mapperd.server.admission import Newcomer, objection
from mapperd.server.dispatch import EventFeed, operate
from mapperd.server.listeners import Listener
from mapperd.wire.auth import FailureLimiter, Limits, TokenBucket
from mapperd.wire.control_messages import (
    VERSION,
    Ask,
    Events,
    Fault,
    Greeting,
    answer_line,
    decode_ask,
    fault_line,
    line_of,
)

__all__ = ["Client", "CutError", "LineBuffer", "LineTooLongError", "Surroundings"]


class LineTooLongError(ValueError):
    """A line is longer than allowed; where the next one begins is not known."""


class LineBuffer:
    """Holds what came until it is a line.

    Args:
        limit: bytes of the longest line, without its end.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._bytes = bytearray()
        self._searched = 0

    def __len__(self) -> int:
        return len(self._bytes)

    def feed(self, data: bytes) -> None:
        """Add what came."""
        self._bytes += data

    def next_line(self) -> bytes | None:
        """The next whole line without its end; None where there is none.

        Raises:
            LineTooLongError: there are more bytes than a line may have.
        """
        end = self._bytes.find(b"\n", self._searched)
        if end > self._limit or (end < 0 and len(self._bytes) > self._limit):
            raise LineTooLongError(f"a line is longer than {self._limit} bytes")
        if end < 0:
            self._searched = len(self._bytes)
            return None
        line = bytes(self._bytes[:end])
        del self._bytes[: end + 1]
        self._searched = 0
        return line.removesuffix(b"\r")


READ_BYTES = 16384
LEAVE_S = 1.0
WRITE_BYTES = 65536
"""Unsent bytes beyond which a client has to read before it is told more."""


class CutError(Exception):
    """The client is let go; the text is the counter's name."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What all clients have in common.

    Attributes:
        operations: the daemon.
        limits: what a client may take.
        failures: of proofs, by address.
        count: one more of something that happened.
        admit: makes a newcomer a client; raises `CutError` where there is no room.
        clock: seconds, as the event loop's.
    """

    operations: DaemonApi
    limits: Limits
    failures: FailureLimiter
    count: Callable[[str], None]
    admit: Callable[["Client"], None]
    clock: Callable[[], float]


class Client:
    """One connection, from the greeting to its end.

    Args:
        door: it came through.
        peer: its address, empty for a Unix socket.
        origin: who it is, as is told in events and settings.
        around: what it shares with others.

    Attributes:
        is_begun: the socket is the client's to close.
    """

    def __init__(self, door: Listener, peer: str, origin: str, around: Surroundings) -> None:
        self.origin = origin
        self._door = door
        self._peer = peer
        self._around = around
        limits = around.limits
        self._lines = LineBuffer(limits.line_bytes)
        self._line_began_s = 0.0
        self._asks = TokenBucket(limits.asks_per_s, limits.asks_at_once)
        self._malformed = 0
        self._sending = asyncio.Lock()
        self._feed: EventFeed | None = None
        self._news = asyncio.Event()
        self._reader = asyncio.StreamReader(READ_BYTES)
        self._writer: asyncio.StreamWriter | None = None
        self.is_begun = False

    async def serve(self, connection: socket.socket) -> None:
        """Serve until it leaves or is cut; the socket is closed then."""
        self.is_begun = True
        limits = self._around.limits
        try:
            async with _within(limits.hello_s, "cut_late_hello"):
                await self._open(connection)
                welcome = await self._welcome()
            if welcome:
                await self._converse()
            await self._leave()
        except CutError as error:
            self._count(str(error))
        except OSError:
            self._count("connections_lost")
        finally:
            if self._writer is not None:
                self._writer.transport.abort()

    async def _open(self, connection: socket.socket) -> None:
        """Make streams of the socket, with TLS if the door wants it."""
        loop = asyncio.get_running_loop()
        limit_s = self._around.limits.hello_s
        reader, tls = self._reader, self._door.tls
        transport, protocol = await loop.connect_accepted_socket(
            lambda: asyncio.StreamReaderProtocol(reader),
            connection,
            ssl=tls,
            ssl_handshake_timeout=limit_s if tls else None,
            ssl_shutdown_timeout=LEAVE_S if tls else None,
        )
        transport.set_write_buffer_limits(high=WRITE_BYTES)
        self._writer = asyncio.StreamWriter(transport, protocol, reader, loop)

    async def _leave(self) -> None:
        """Let the last words arrive."""
        if self._writer is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LEAVE_S):
                    self._writer.close()
                    await self._writer.wait_closed()

    async def _welcome(self) -> bool:
        """Greet it and hear its hello; whether it may stay."""
        token = self._door.token
        challenge = secrets.token_hex(16) if token is not None else ""
        await self._send(line_of(Greeting(challenge=challenge)))
        line = await self._next_line()
        if line is None:
            return False
        hello, number = decode_ask(line)
        fault = self._objection(hello, challenge)
        if fault is None:
            try:
                self._around.admit(self)
            except CutError as error:
                self._count(str(error))
                fault = Fault("too_many_clients", "as many clients as allowed are connected")
        if fault is not None:
            await self._send(fault_line(number, fault))
            return False
        await self._send(answer_line(number, {"version": VERSION}))
        return True

    def _objection(self, hello: Ask | Fault, challenge: str) -> Fault | None:
        """Why this newcomer may not come in, counted and told."""
        around = self._around
        newcomer = Newcomer(self._peer, challenge, self._door.token)
        fault = objection(newcomer, hello, around.failures, around.clock())
        if fault is None:
            return None
        self._count(f"hello_{fault.reason}")
        if fault.reason == "wrong_token":
            around.operations.events.add(
                Severity.WARNING,
                "control_wrong_token",
                f"{self._peer} does not know the token of the control socket",
                address=self._peer,
            )
        return fault

    async def _converse(self) -> None:
        """Answer its requests in their order, and tell it the events that it follows."""
        telling = asyncio.create_task(self._tell_events())
        listening = asyncio.create_task(self._listen())
        try:
            await asyncio.wait((telling, listening), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (telling, listening):
                task.cancel()
            outcomes = await asyncio.gather(telling, listening, return_exceptions=True)
        for outcome in outcomes:
            if isinstance(outcome, Exception):
                raise outcome

    async def _listen(self) -> None:
        while (line := await self._next_line()) is not None:
            wait_s = self._asks.take(self._around.clock())
            if wait_s > 0:
                self._count("throttled")
                await asyncio.sleep(wait_s)
            ask, number = decode_ask(line)
            if isinstance(ask, Fault):
                await self._send(fault_line(number, ask))
                self._note_malformed()
            else:
                await self._send(await self._answer(ask))

    async def _answer(self, ask: Ask) -> bytes:
        """Whatever goes wrong in what was asked, the client is told and the daemon goes on."""
        self._count("requests")
        try:
            if isinstance(ask, Events):
                return answer_line(ask.id, self._follow(ask))
            result = await operate(ask, self._around.operations, self.origin)
            if isinstance(result, Fault):
                self._count("refused")
                return fault_line(ask.id, result)
            return answer_line(ask.id, result)
        except Exception as error:  # noqa: BLE001 a fault of ours must not end the daemon
            self._count("failed")
            what = f"{type(ask).__name__.lower()}: {type(error).__name__}: {error}"
            self._around.operations.events.add(Severity.ERROR, "control_failed", what)
            return fault_line(ask.id, Fault("failed", what))

    def _follow(self, ask: Events) -> dict[str, object]:
        feed = EventFeed(self._around.operations.events, ask.since)
        first = feed.take()
        if ask.follow:
            self._feed = feed
            self._news.set()
        return first

    def wake(self, _: Event | None = None) -> None:
        """There may be news; in the event loop."""
        self._news.set()

    async def _tell_events(self) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._feed is not None:
                told = self._feed.take()
                if not told["events"] and not told["missed"]:
                    break
                await self._send(line_of(told))

    async def _next_line(self) -> bytes | None:
        """Its next request; None when it left.

        Raises:
            CutError: it is too slow, too long or silent.
        """
        limits, clock = self._around.limits, self._around.clock
        while True:
            try:
                line = self._lines.next_line()
            except LineTooLongError as error:
                await self._send(fault_line(None, Fault("too_long", str(error))))
                raise CutError("cut_too_long") from error
            if line is not None:
                self._line_began_s = clock()
                return line
            if self._lines:
                left_s = max(0.0, self._line_began_s + limits.line_s - clock())
                waiting = _within(left_s, "cut_slow_sending")
            else:
                waiting = _within(None if self._feed else limits.idle_s, "cut_idle")
            async with waiting:
                data = await self._reader.read(READ_BYTES)
            if not data:
                return None
            if not self._lines:
                self._line_began_s = clock()
            self._lines.feed(data)

    async def _send(self, line: bytes) -> None:
        """Say something; who does not read it is cut."""
        writer = self._writer
        assert writer is not None  # noqa: S101 there is one as soon as the socket is open
        async with self._sending:
            writer.write(line)
            async with _within(self._around.limits.write_s, "cut_slow_reading"):
                await writer.drain()

    def _note_malformed(self) -> None:
        self._count("malformed")
        self._malformed += 1
        if self._malformed >= self._around.limits.malformed:
            raise CutError("cut_malformed")

    def _count(self, what: str) -> None:
        self._around.count(what)


@contextlib.asynccontextmanager
async def _within(limit_s: float | None, counter: str) -> AsyncIterator[None]:
    try:
        async with asyncio.timeout(limit_s):
            yield
    except TimeoutError as error:
        raise CutError(counter) from error
