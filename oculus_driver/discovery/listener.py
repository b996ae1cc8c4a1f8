"""Listens for status broadcasts. Other programs may listen on the same port of this host."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Final, Protocol
from weakref import WeakSet

from oculus_driver.discovery.diagnosis import bind_finding, status_findings
from oculus_driver.discovery.state import DiscoveredSonar, DiscoveryState, SonarKey
from oculus_driver.errors import DiscoveryError
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from types import TracebackType
    from typing import Self

    from oculus_driver.status import Status


ANY_HOST: Final = "0.0.0.0"  # noqa: S104 - needed to receive broadcasts

_LOG: Final = logging.getLogger(__name__)


class Discovery:
    """Receives the status broadcasts of all sonars within an `async with` block.

    Other programs can listen on the same port at the same time if they share it, too. New sonars
    and each new problem of a sonar are logged once. A client that uses a sonar is no problem here:
    it may be this program.

    Attributes:
        state: the discovered sonars, and counters of rejected datagrams.
        dropped: updates that reached no iterator, by reason: superseded (a newer status of the
            same sonar arrived before the reader took it), socket_error.

    Args:
        port: UDP port; 0 for any free one, see attribute `port`.
        host: local address to listen on.
        clock_ns: the host's monotonic clock.
    """

    def __init__(
        self,
        port: int = STATUS_PORT,
        host: str = ANY_HOST,
        *,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.state = DiscoveryState()
        self.dropped: Counter[str] = Counter()
        self._port = port
        self._host = host
        self._clock_ns = clock_ns
        self._transport: asyncio.DatagramTransport | None = None
        self._closed: asyncio.Future[None] | None = None
        self._readers: WeakSet[DiscoveryUpdates] = WeakSet()
        self._reported: dict[SonarKey, frozenset[str]] = {}

    @property
    def port(self) -> int:
        """The UDP port in use."""
        return self._port

    async def __aenter__(self) -> Self:
        """Start listening.

        Raises:
            DiscoveryError: the port cannot be opened; the message contains reason and remedy.
        """
        loop = asyncio.get_running_loop()
        listening = _listening_socket(self._host, self._port)
        self._port = listening.getsockname()[1]
        self._closed = loop.create_future()
        receiver = _DatagramReceiver(self._take, self._fail, self._closed)
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: receiver, sock=listening
            )
        except BaseException:
            listening.close()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop listening; iterators end."""
        for reader in self._readers:
            reader.finish()
        if self._transport is not None and self._closed is not None:
            self._transport.close()
            self._transport = None
            await self._closed

    def present(self) -> list[DiscoveredSonar]:
        """Return the sonars that are present now, in order of their first status."""
        return self.state.present(self._clock_ns())

    def updates(self) -> DiscoveryUpdates:
        """Return an iterator over statuses as they arrive, starting with the known sonars.

        A slow reader gets only the newest status of each sonar. Every iterator gets all sonars. It
        ends at the end of the `async with` block.
        """
        reader = DiscoveryUpdates(self.dropped)
        for found in self.present():
            reader.offer(found)
        if self._transport is None:
            reader.finish()
        self._readers.add(reader)
        return reader

    def _take(self, datagram: bytes, source_address: str) -> None:
        found = self.state.feed(datagram, source_address, self._clock_ns())
        if isinstance(found, DiscoveredSonar):
            self._report(found)
            for reader in self._readers:
                reader.offer(found)

    def _fail(self, error: OSError) -> None:
        self.dropped["socket_error"] += 1
        _LOG.debug("status port %d: %s", self._port, error)

    def _report(self, found: DiscoveredSonar) -> None:
        """Log a new sonar and its new problems."""
        if found.count == 1:
            model, serial = found.model.name, found.status.device_id
            _LOG.info("%s, serial number %d, at %s", model, serial, found.address)
            self._reported = {
                key: self._reported[key] for key in self.state.sonars if key in self._reported
            }
        findings = status_findings(found.status, connected=True)
        before = self._reported.get(found.key, frozenset())
        self._reported[found.key] = frozenset(finding.code for finding in findings)
        for finding in findings:
            if finding.code not in before and finding.severity != "note":
                _LOG.warning("%s", finding.text)


class DiscoveryUpdates:
    """Statuses as they arrive: the newest of each sonar, in order of arrival."""

    def __init__(self, dropped: Counter[str]) -> None:
        self._waiting: dict[SonarKey, DiscoveredSonar] = {}
        self._dropped = dropped
        self._wake = asyncio.Event()
        self._finished = False

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> DiscoveredSonar:
        while not self._waiting:
            if self._finished:
                raise StopAsyncIteration
            self._wake.clear()
            await self._wake.wait()
        return self._waiting.pop(next(iter(self._waiting)))

    def offer(self, found: DiscoveredSonar) -> None:
        """Queue a sonar for the reader; replaces an older status of the same sonar."""
        if self._waiting.pop(found.key, None) is not None:
            self._dropped["superseded"] += 1
        self._waiting[found.key] = found
        self._wake.set()

    def finish(self) -> None:
        """End the iteration after the queued sonars."""
        self._finished = True
        self._wake.set()


class _DatagramReceiver(asyncio.DatagramProtocol):
    """Passes datagrams and errors of the socket on."""

    def __init__(
        self,
        take: Callable[[bytes, str], None],
        fail: Callable[[OSError], None],
        closed: asyncio.Future[None],
    ) -> None:
        self._take = take
        self._fail = fail
        self._closed = closed

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._take(data, addr[0])

    def error_received(self, exc: Exception) -> None:
        if isinstance(exc, OSError):
            self._fail(exc)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - name of the base class
        if not self._closed.done():
            self._closed.set_result(None)


def _listening_socket(host: str, port: int) -> socket.socket:
    """Return a bound socket that shares its port."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        listening.settimeout(0)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            with contextlib.suppress(OSError):  # some kernels define the name but lack the option
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise DiscoveryError(bind_finding(error, host, port).text) from error
    return listening


class Announcement(Protocol):
    """One status broadcast of a sonar: where to connect, and its status."""

    @property
    def address(self) -> str:
        """Where to connect."""
        ...

    @property
    def status(self) -> Status:
        """The last status."""
        ...


class AnnouncementSource(Protocol):
    """A source of announcements, such as `Discovery`."""

    def updates(self) -> AsyncIterator[Announcement]:
        """Return an iterator over announcements as they arrive."""
        ...


DiscoveryFactory = Callable[[], AbstractAsyncContextManager[AnnouncementSource]]


class SonarSearch:
    """Searches for one sonar, in a task.

    Args:
        serial: its device id; None: the first sonar discovered.
        discovery: makes the source of announcements; None: `Discovery`.
        address: of the sonar; None: any.

    Attributes:
        status: last status of the sonar, None before the first one.
    """

    def __init__(
        self,
        serial: int | None,
        discovery: DiscoveryFactory | None,
        address: str | None = None,
    ) -> None:
        self.status: Status | None = None
        self._serial = serial
        self._address = address
        self._discovery = discovery or Discovery
        self._ignored: set[int] = set()
        self._task: asyncio.Task[None] | None = None

    def start(
        self,
        on_found: Callable[[Announcement], None],
        on_failure: Callable[[BaseException], None],
    ) -> None:
        """Start the task; exceptions are passed to `on_failure`."""
        self._task = asyncio.create_task(self._listen(on_found, on_failure))

    async def stop(self) -> None:
        """Cancel the task and wait for its end."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait((self._task,))

    async def _listen(
        self,
        on_found: Callable[[Announcement], None],
        on_failure: Callable[[BaseException], None],
    ) -> None:
        try:
            async with self._discovery() as discovery:
                async for found in discovery.updates():
                    if self._is_selected(found):
                        on_found(found)
        except Exception as error:  # noqa: BLE001 - passed to the readers of pings
            on_failure(error)

    def _is_selected(self, found: Announcement) -> bool:
        serial = found.status.device_id
        if self._address not in (None, found.address):
            return False
        if self._serial is None:
            self._serial = serial
        if serial == self._serial:
            self.status = found.status
            return True
        if serial not in self._ignored and len(self._ignored) < MAX_OTHERS_LOGGED:
            self._ignored.add(serial)
            words = "ignoring sonar %d at %s, using sonar %d: set a serial number to choose"
            _LOG.warning(words, serial, found.address, self._serial)
        return False


MAX_OTHERS_LOGGED: Final = 16


def addresses_towards(address: str) -> list[IPv4Address]:
    """Return the local address from which this host would connect to `address`, or an empty list.

    Queries the routing table and sends nothing. `address` must be dotted: a name lookup can take
    seconds. A route through a gateway counts, too: compare with the sonar's netmask
    (`oculus_driver.discovery.diagnosis.subnet_finding`).
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, TCP_PORT))
        except OSError:
            return []
        return [IPv4Address(probe.getsockname()[0])]
