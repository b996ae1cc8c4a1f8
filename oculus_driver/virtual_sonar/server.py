"""Serves a virtual sonar on the network: statuses on UDP, pings on TCP, fire messages."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Final, Generic, Protocol, Self, TypeVar

from oculus_driver.encode import encode_dummy
from oculus_driver.errors import OculusError
from oculus_driver.virtual_sonar.device import CommandReader
from oculus_driver.virtual_sonar.faults import FaultedPing, FaultInjector, Faults

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence
    from types import TracebackType


@dataclass(slots=True)
class VirtualSonarCounters:
    """Counters of a virtual sonar.

    Attributes:
        clients: clients served; refused: clients rejected at once.
        pings: complete pings; pings_damaged: pings with injected faults.
        other_messages: dummies, replies and other recorded messages.
        bytes_sent: on the data port.
        stalls, restarts, cuts: injected faults.
        statuses: datagrams sent; statuses_unsent: refused by the network.
    """

    clients: int = 0
    refused: int = 0
    pings: int = 0
    pings_damaged: int = 0
    other_messages: int = 0
    bytes_sent: int = 0
    stalls: int = 0
    restarts: int = 0
    cuts: int = 0
    statuses: int = 0
    statuses_unsent: int = 0


_MAX_READ: Final = 1 << 16
_FLUSH_S: Final = 1.0
"""Time for a disconnected client to read what was sent."""

_LATE_S: Final = 0.5
"""A ping later than this is not caught up: over a slow link a sonar sends fewer pings, too."""

ANY: Final = IPv4Address("0.0.0.0")  # noqa: S104 - compared, not bound


class Device(Protocol):
    """The inside of a virtual sonar: processes fire messages and produces messages.

    `virtual_sonar.playback.PlaybackDevice` takes them from a recording; a simulator computes them.
    """

    @property
    def pinging(self) -> bool:
        """Whether it transmits, continuously or on triggers."""

    @property
    def ended(self) -> bool:
        """Whether there are no more messages."""

    @property
    def source_id(self) -> int:
        """Source id in the headers of its own messages."""

    @property
    def triggered(self) -> bool:
        """Whether each ping needs its own fire message."""

    @property
    def triggers(self) -> int:
        """Number of fire messages without a ping yet, in triggered mode."""

    @property
    def next_is_ping(self) -> bool:
        """Whether the next message is a ping."""

    def receive(self, reader: CommandReader, data: bytes) -> list[bytes]:
        """Process bytes of a client and return the replies."""

    async def prepare(self) -> None:
        """Prepare the next message; may take any time, be cancelled, and be repeated."""

    def wait_ns(self) -> int:
        """Return the time between the previous message and the prepared one."""

    def take(self) -> tuple[bytes, int | None]:
        """Return the prepared message and, of a ping, its id."""

    def restart(self) -> None:
        """Restart ids and device time; the settings stay."""

    def status(self, client: IPv4Address | None) -> bytes:
        """Return a status datagram; `client` is the connected client."""

    def close(self) -> None:
        """Release resources."""


DeviceT = TypeVar("DeviceT", bound=Device)


class VirtualSonar(Generic[DeviceT]):
    """A sonar on this computer within an `async with` block. It serves one client at a time.

    Args:
        device: the inside of the sonar.
        host: address to listen on.
        port: TCP port; 0 for any free one, see attribute `port`.
        speed: factor on the device's time; None: as fast as the client reads. The attribute
            of this name may change at any time.
        status_to: destinations of statuses, such as `(broadcast_of(host), STATUS_PORT)`.
        status_period_s, dummy_period_s: interval of statuses; interval of dummies in standby.
        faults: injected faults.
        on_ping: called with the id of each sent ping, and whether it is complete.

    Raises:
        OculusError: the address cannot be opened; raised on entering.
    """

    def __init__(
        self,
        device: DeviceT,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        speed: float | None = 1.0,
        status_to: Sequence[tuple[str, int]] = (),
        status_period_s: float = 1.0,
        dummy_period_s: float = 1.0,
        faults: Faults | None = None,
        on_ping: Callable[[int, bool], None] | None = None,
    ) -> None:
        self.host = host
        self.port = port
        self.counters = VirtualSonarCounters()
        self.finished = asyncio.Event()
        self.faults = faults or Faults()
        self.device = device
        self.speed = speed
        self._status_to = tuple(status_to)
        self._status_period_s = status_period_s
        self._dummy_period_s = dummy_period_s
        self._on_ping = on_ping
        self._injector = FaultInjector(self.faults)
        self._tasks = asyncio.TaskGroup()
        self._running: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._serving = asyncio.Lock()
        self._changed = asyncio.Event()
        self._client: IPv4Address | None = None
        self._heard_s = 0.0
        self._due_s = 0.0
        self._alive_s = 0.0

    @property
    def connected(self) -> bool:
        """Whether a client is served now."""
        return self._serving.locked()

    async def __aenter__(self) -> Self:
        try:
            self._server = await asyncio.start_server(self._connected, self.host, self.port)
        except OSError as error:
            raise OculusError(_listen_error(self.host, self.port, error)) from error
        self.port = int(self._server.sockets[0].getsockname()[1])
        await self._tasks.__aenter__()
        if self._status_to:
            self._start(self._statuses())
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._server is not None:
            self._server.close()
        for task in self._running:
            task.cancel()
        for writer in self._writers:
            writer.transport.abort()
        try:
            cancelled = kind is not None and issubclass(kind, asyncio.CancelledError)
            passed = (kind, error, trace) if cancelled else (None, None, None)
            await self._tasks.__aexit__(*passed)  # do not wrap exceptions of the body
        finally:
            self.device.close()
            if self._server is not None:
                await self._server.wait_closed()

    def _start(self, work: Coroutine[None, None, None]) -> None:
        task = self._tasks.create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        self._start(self._serve(reader, writer))

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if self.faults.refuse_second and self._serving.locked():
                self.counters.refused += 1
                return
            async with self._serving:
                self.counters.clients += 1
                peer = writer.get_extra_info("peername")  # None if the client has disconnected
                self._client = IPv4Address(peer[0]) if peer else None
                await _run_until_first(self._receive(reader, writer), self._send(writer))
                await _flush_and_close(reader, writer)
        except OSError:
            pass  # the client has disconnected; "not connected" is not a ConnectionError
        finally:
            if not self._serving.locked():
                self._client = None
            self._writers.discard(writer)
            await _close(writer)
            if self.device.ended:
                self.finished.set()

    async def _receive(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Process the client's messages until it disconnects."""
        commands = CommandReader()
        self._heard_s = _now_s()
        while data := await reader.read(_MAX_READ):
            for reply in self.device.receive(commands, data):
                writer.write(reply)
                self.counters.other_messages += 1
            self._heard_s = _now_s()
            self._changed.set()

    async def _send(self, writer: asyncio.StreamWriter) -> None:
        """Send messages when they are due, until a fault closes the connection."""
        self._due_s = self._alive_s = _now_s()
        writer.transport.set_write_buffer_limits(high=0)  # drained bytes are in the kernel
        while True:
            if self.device.ended:
                self.finished.set()
            if not self.device.pinging or self._client_timed_out():
                await self._send_dummy(writer)
            elif not await self._is_due():
                continue
            elif self.device.next_is_ping:
                if not await self._send_ping(writer):
                    return
            else:
                data, _ = self.device.take()
                self.counters.other_messages += 1
                await self._write(writer, data)

    async def _is_due(self) -> bool:
        """Wait for the next message; return False if the settings changed first."""
        if self.device.triggered and self.device.next_is_ping and not self.device.triggers:
            await self._wait_for_change(None)
            return False
        await self.device.prepare()
        if self.speed is None:
            await asyncio.sleep(0)
            return True
        due_s = max(self._due_s + self.device.wait_ns() / 1e9 / self.speed, _now_s() - _LATE_S)
        if await self._wait_for_change(due_s - _now_s()):
            return False
        self._due_s = due_s
        return True

    async def _send_ping(self, writer: asyncio.StreamWriter) -> bool:
        """Send the next ping with its faults; return False if the connection ends."""
        match self._injector.before_ping():
            case "restart":
                self.counters.restarts += 1
                self.device.restart()
                return False
            case "restart_ids":
                self.device.restart()
                await self.device.prepare()
            case "stall":
                self.counters.stalls += 1
                await asyncio.sleep(self.faults.stall_s)
        data, ping_id = self.device.take()
        faulted = self._injector.apply(data)
        self._count(faulted, ping_id)
        await self._write(writer, faulted.noise + faulted.data)
        return not faulted.cut

    def _count(self, faulted: FaultedPing, ping_id: int | None) -> None:
        self.counters.pings += not faulted.damaged
        self.counters.pings_damaged += faulted.damaged
        self.counters.cuts += faulted.cut
        if self._on_ping is not None and ping_id is not None:
            self._on_ping(ping_id, not faulted.damaged)

    async def _write(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        piece = self.faults.piece_bytes or max(1, len(data))
        for start in range(0, len(data), piece):
            writer.write(data[start : start + piece])
            await writer.drain()
            if piece < len(data):
                await asyncio.sleep(0)
        self.counters.bytes_sent += len(data)

    async def _send_dummy(self, writer: asyncio.StreamWriter) -> None:
        """Send a dummy at intervals in standby. The time of the recording stands still."""
        next_s = self._alive_s + self._dummy_period_s
        if not await self._wait_for_change(next_s - _now_s()):
            self._alive_s = _now_s()
            if not self._client_timed_out():
                self.counters.other_messages += 1
                await self._write(writer, encode_dummy(source_id=self.device.source_id))
        self._due_s = _now_s()

    def _client_timed_out(self) -> bool:
        """Return whether the client has not sent a fire message for too long."""
        limit_s = self.faults.silent_after_s
        return limit_s is not None and _now_s() - self._heard_s > limit_s

    async def _wait_for_change(self, limit_s: float | None) -> bool:
        """Wait for a message of the client, at most `limit_s`; return whether there was one."""
        if limit_s is not None and limit_s <= 0.0:
            await asyncio.sleep(0)
        else:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    await self._changed.wait()
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    async def _statuses(self) -> None:
        await broadcast(
            lambda: self.device.status(self._client),
            self.host,
            self._status_to,
            self._status_period_s,
            faults=self._injector,
            counters=self.counters,
        )


async def _flush_and_close(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """End the stream and read until the client has received everything.

    Closing with unread commands would reset the connection, and the client would lose complete
    pings.
    """
    writer.write_eof()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_FLUSH_S):
            while await reader.read(_MAX_READ):
                pass


async def _close(writer: asyncio.StreamWriter) -> None:
    """Close a connection, whether or not its client reads the rest."""
    writer.close()
    try:
        async with asyncio.timeout(_FLUSH_S):
            await writer.wait_closed()
    except TimeoutError:
        writer.transport.abort()
    except asyncio.CancelledError:
        writer.transport.abort()
        raise
    except OSError:
        pass  # the client closed first


def _now_s() -> float:
    return asyncio.get_running_loop().time()


async def _run_until_first(*works: Coroutine[None, None, None]) -> None:
    """Run until the first one ends, cancel the others, and raise their exceptions."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
    for outcome in outcomes:
        if isinstance(outcome, Exception):
            raise outcome


def _listen_error(host: str, port: int, error: OSError) -> str:
    reason = error.strerror or str(error)
    return f"cannot listen on {host}:{port}: {reason}; use another address or port"


def broadcast_of(host: str) -> str:
    """Return the broadcast address for a sonar at this address; loopback stays on loopback."""
    return "127.255.255.255" if IPv4Address(host).is_loopback else "255.255.255.255"


class _StatusSender(asyncio.DatagramProtocol):
    """Counts send errors; asyncio reports them after the call."""

    def __init__(self, counters: VirtualSonarCounters) -> None:
        self._counters = counters

    def error_received(self, _: Exception) -> None:
        self._counters.statuses_unsent += 1


async def broadcast(
    status: Callable[[], bytes],
    host: str,
    targets: Sequence[tuple[str, int]],
    period_s: float,
    *,
    faults: FaultInjector,
    counters: VirtualSonarCounters,
) -> None:
    """Send statuses until cancelled. A fault swaps a status with the next one and repeats that.

    Args:
        status: makes the present datagram.
        host: address to send from.
        targets: addresses and ports.
        period_s: interval of statuses.
        faults: decide which statuses are delayed.
        counters: `statuses` and `statuses_unsent` are incremented.
    """
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _StatusSender(counters), local_addr=(host, 0), allow_broadcast=True
    )
    held: bytes | None = None
    try:
        while True:
            now = status()
            if held is None and faults.delays_status():
                held = now
            else:
                datagrams = (now,) if held is None else (now, held, now)
                held = None
                for target in targets:
                    for datagram in datagrams:
                        transport.sendto(datagram, target)
                        counters.statuses += 1
            await asyncio.sleep(period_s)
    finally:
        transport.close()
