"""Executes the actions of the link on sockets and timers, and feeds received bytes to it."""

from __future__ import annotations

import asyncio
import errno
import socket
from typing import TYPE_CHECKING, Final, cast

from oculus_driver.link.receiver import PingReceiver
from oculus_driver.link.state import (
    SECOND_NS,
    Action,
    Connect,
    Disconnect,
    LinkState,
    Send,
    SonarCounters,
)
from oculus_driver.wire import MIB

if TYPE_CHECKING:
    from collections.abc import Callable

    from oculus_driver.link.machine import Link
    from oculus_driver.link.receiver import ReceivedMessage
    from oculus_driver.link.state import LinkStatus
    from oculus_driver.stream import Framing, MessageBounds


RECEIVE_BUFFER: Final = 2 * MIB
_MAX_UNSENT_BYTES: Final = 4096

_MAX_LATE_NS: Final = SECOND_NS // 5
"""A timer that is later shows that this program did not run: it was stopped, or busy."""

_ADVICE: Final = {
    errno.ECONNREFUSED: "refused: another client may use the sonar, or the address is not a sonar",
    errno.EHOSTUNREACH: "failed, host unreachable: check power, cable and address",
    errno.ENETUNREACH: "failed, network unreachable: give this host an address in its subnet",
    errno.ECONNRESET: "reset by the sonar",
    errno.EPIPE: "closed by the sonar",
    errno.ETIMEDOUT: "timed out: check power and cable",
}


def describe_error(error: BaseException | None) -> str:
    """Return why a connection ended; None stands for a regular end by the sonar."""
    if error is None:
        return "connection closed by the sonar"
    advice = _ADVICE.get(getattr(error, "errno", None) or 0)
    return f"connection {advice}" if advice else f"connection failed: {error}"


class Connection(asyncio.Protocol):
    """One TCP connection. After `drop` it calls no callback any more.

    Bytes are passed on directly from the event loop's read, not by a task. So a late timer never
    runs before bytes that arrived in time.

    Args:
        on_connected: called with the connection once it is open.
        on_data: called with the bytes of each read.
        on_lost: called with the reason if the connection ends and `drop` was not called.
    """

    def __init__(
        self,
        on_connected: Callable[[Connection], None],
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._on_connected = on_connected
        self._on_data = on_data
        self._on_lost = on_lost
        self._transport: asyncio.Transport | None = None
        self._dropped = False
        self._unresponsive = False
        self.closed = asyncio.get_running_loop().create_future()

    @property
    def is_open(self) -> bool:
        """Whether the connection was established and has not ended."""
        return self._transport is not None and not self._dropped

    @property
    def local_address(self) -> str | None:
        """This host's address on the connection."""
        name = None if self._transport is None else self._transport.get_extra_info("sockname")
        return str(name[0]) if name else None

    def send(self, data: bytes) -> None:
        """Send one message in one write."""
        if self._transport is None or self._transport.is_closing():
            return
        self._transport.write(data)
        if self._transport.get_write_buffer_size() > _MAX_UNSENT_BYTES:
            self._unresponsive = True
            self._transport.abort()

    def drop(self) -> None:
        """Abort the connection."""
        self._dropped = True
        if self._transport is None:
            self._close()
        else:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Store the transport; called by the event loop."""
        self._transport = cast("asyncio.Transport", transport)
        if self._dropped:
            self._transport.abort()
        else:
            self._on_connected(self)

    def data_received(self, data: bytes) -> None:
        """Pass bytes on; called by the event loop."""
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Report the end; called by the event loop."""
        self._close()
        if not self._dropped:
            self._dropped = True
            self._on_lost(
                "the sonar stopped reading commands" if self._unresponsive else describe_error(exc)
            )

    def _close(self) -> None:
        if not self.closed.done():
            self.closed.set_result(None)


async def open_connection(connection: Connection, address: str, port: int) -> None:
    """Connect to a sonar's data port.

    Raises:
        OSError: the sonar is unreachable; see `describe_error`.
    """
    loop = asyncio.get_running_loop()
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        endpoint.setblocking(False)  # noqa: FBT003 - the socket module's own signature
        endpoint.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if _allows_receive_buffer(RECEIVE_BUFFER):
            endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        await loop.sock_connect(endpoint, (address, port))
        await loop.create_connection(lambda: connection, sock=endpoint)
    except BaseException:
        endpoint.close()
        raise


def _allows_receive_buffer(size: int) -> bool:
    """Return whether this host grants the requested size of a receive buffer.

    On a host that does not, a request gives less than the automatic size: it ends the automatic
    growth of the buffer.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
        return probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= size


class LinkDriver:
    """Owns the connection of one link.

    Everything runs in callbacks of the event loop; the only task is the connection attempt.

    Args:
        link: the state machine.
        port: of the data connection.
        clock: host monotonic time, nanoseconds.
        on_bytes: called with all received bytes before they are parsed, and their arrival time.
        on_chunk: called with the same after they are parsed, and the message boundaries in them.
        on_framing: called with the same after they are parsed, and what was found in them.
        on_received: called with each message, and with its ping if it is valid.
        on_status: called with the link's status after a change of state or reason.
        on_failure: called with an exception raised by one of these callbacks.

    Attributes:
        link: as given.
        failure: the exception that ended the link, None without one.
    """

    def __init__(
        self,
        link: Link,
        *,
        port: int,
        clock: Callable[[], int],
        on_bytes: Callable[[bytes, int], None] | None,
        on_chunk: Callable[[bytes, int, MessageBounds], object] | None,
        on_framing: Callable[[bytes, int, Framing], object] | None,
        on_received: Callable[[ReceivedMessage, int], None],
        on_status: Callable[[LinkStatus], None],
        on_failure: Callable[[BaseException], None],
    ) -> None:
        self.link = link
        self.failure: BaseException | None = None
        self._port = port
        self._clock = clock
        self._on_bytes = on_bytes
        self._on_chunk = on_chunk
        self._on_framing = on_framing
        self._on_received = on_received
        self._on_status = on_status
        self._on_failure = on_failure
        self._receiver = PingReceiver()
        self._connection: Connection | None = None
        self._attempt: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._due_ns = 0  # of the timer
        self._reported: tuple[LinkState, str] | None = None
        self._connections = 0
        self._losses = 0
        self._sent = 0

    @property
    def is_connected(self) -> bool:
        """Whether a connection is open."""
        return self._connection is not None and self._connection.is_open

    @property
    def connection_closed(self) -> asyncio.Future[None]:
        """Done when the open connection has ended."""
        if self._connection is None:
            done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            done.set_result(None)
            return done
        return self._connection.closed

    def counters(self, *, taken: int, dropped: int, queued: int) -> SonarCounters:
        """Return all counters, including those of the ping queue."""
        stream, sequence = self._receiver.stream, self._receiver.sequence
        return SonarCounters(
            connections=self._connections,
            losses=self._losses,
            bytes_received=stream.bytes_total,
            bytes_rejected=stream.bytes_rejected,
            resyncs=stream.resyncs,
            messages=dict(stream.messages),
            rejects=dict(stream.rejects + self._receiver.rejects),
            pings=self._receiver.pings,
            taken=taken,
            dropped=dropped,
            queued=queued,
            duplicates=sequence.duplicates,
            lost_pings=sequence.lost_pings,
            restarts=sequence.restarts,
            sent=self._sent,
        )

    def start(self) -> None:
        """Start the link."""
        self.do(self.link.start(self._clock()))

    def do(self, actions: list[Action]) -> None:
        """Execute the actions of the link and schedule its next deadline."""
        if self.failure is not None:
            return
        try:
            for action in actions:
                self._do_one(action)
            self._report()
        except Exception as error:  # noqa: BLE001 - a callback may raise anything
            self._on_failure(error)
        else:
            self._schedule_check()

    def fail(self, error: BaseException) -> None:
        """Stop permanently."""
        self.failure = self.failure or error
        self._stop()
        self.link.close(f"failed: {error}", self._clock())

    async def close(self, reason: str) -> None:
        """Close the connection and wait until it has ended."""
        connection, attempt = self._connection, self._attempt
        self.link.close(reason, self._clock())
        self._stop()
        if attempt is not None and not attempt.done():
            await asyncio.wait((attempt,))
        if connection is not None:
            await connection.closed
        if self.failure is None:
            self._report()

    def _do_one(self, action: Action) -> None:
        match action:
            case Connect(address):
                connection = Connection(self._connected, self._data, self._lost)
                self._connection = connection
                self._attempt = asyncio.create_task(self._connect(connection, address))
            case Disconnect():
                self._losses += 1
                self._stop()
            case Send(data):
                self._sent += 1
                if self._connection is not None:
                    self._connection.send(data)

    async def _connect(self, connection: Connection, address: str) -> None:
        try:
            await open_connection(connection, address, self._port)
        except OSError as error:
            if connection is self._connection:
                self._lost(describe_error(error))
        except Exception as error:  # noqa: BLE001 - such as an invalid host name
            self._on_failure(error)

    def _connected(self, connection: Connection) -> None:
        self._connections += 1
        self.do(self.link.connected(self._clock(), connection.local_address))

    def _data(self, data: bytes) -> None:
        now_ns = self._clock()
        self._forgive_pause(now_ns)
        try:
            if self._on_bytes is not None:
                self._on_bytes(data, now_ns)
            messages = self._receiver.feed(data, now_ns)
            if self._on_chunk is not None:
                self._on_chunk(data, now_ns, self._receiver.framing.bounds)
            if self._on_framing is not None:
                self._on_framing(data, now_ns, self._receiver.framing)
            for received in messages:
                self._handle(received, now_ns)
        except Exception as error:  # noqa: BLE001 - a callback may raise anything
            self._on_failure(error)
            return
        self._check(now_ns)

    def _handle(self, received: ReceivedMessage, now_ns: int) -> None:
        self.link.message_received(received.message_id, now_ns)
        if received.ping is not None:
            self.link.ping_received(now_ns)
        self._on_received(received, now_ns)

    def _lost(self, reason: str) -> None:
        self._losses += 1
        self._connection = None
        self._flush()
        self.do(self.link.lost(reason, self._clock()))

    def _stop(self) -> None:
        """Drop connection, connection attempt and timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._attempt is not None:
            self._attempt.cancel()
        if self._connection is not None:
            self._connection.drop()
            self._connection = None
            self._flush()

    def _flush(self) -> None:
        """Process what the ended connection had received."""
        now_ns = self._clock()
        received = self._receiver.finish()
        if self.failure is not None:
            return
        try:
            for one in received:
                self._on_received(one, now_ns)
        except Exception as error:  # noqa: BLE001 - a callback may raise anything
            self._on_failure(error)

    def _check(self, now_ns: int) -> None:
        """Run due timers, and abort a connection whose bytes make no sense."""
        fault = self._receiver.fault(now_ns) if self.is_connected else None
        if fault is not None:
            self.do(self.link.abort_connection(fault, now_ns))
        else:
            self.do(self.link.tick(now_ns))

    def _report(self) -> None:
        status = self.link.status
        if (status.state, status.reason) != self._reported:
            self._reported = status.state, status.reason
            self._on_status(status)

    def _schedule_check(self) -> None:
        """Schedule `_check` at the next deadline; an earlier timer stays."""
        deadlines = [self.link.deadline_ns]
        if self.is_connected:
            deadlines.append(self._receiver.deadline_ns)
        due_ns = min((one for one in deadlines if one is not None), default=None)
        if due_ns is None:
            return
        loop = asyncio.get_running_loop()
        now_ns = self._clock()
        due_ns = max(due_ns, now_ns)
        when = loop.time() + (due_ns - now_ns) / SECOND_NS
        if self._timer is not None:
            if self._timer.when() <= when and not self._timer.cancelled():
                return
            self._timer.cancel()
        self._timer, self._due_ns = loop.call_at(when, self._due), due_ns

    def _due(self) -> None:
        now_ns = self._clock()
        self._forgive_pause(now_ns)
        self._timer = None
        self._check(now_ns)

    def _forgive_pause(self, now_ns: int) -> None:
        """Postpone all timeouts by the time in which this program did not run."""
        pause_ns = now_ns - self._due_ns
        if self._timer is not None and pause_ns > _MAX_LATE_NS:
            self._due_ns = now_ns
            self.link.postpone(pause_ns)
            self._receiver.postpone(pause_ns)
