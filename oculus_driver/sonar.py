"""The driver's main class: one sonar on the network."""

from __future__ import annotations

import asyncio
import logging
import random
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Self

from oculus_driver.discovery.listener import SonarSearch
from oculus_driver.errors import DiscoveryError, LinkError, SettingsError
from oculus_driver.link.confirmation import (
    CONFIRM_TIMEOUT_NS,
    Confirmation,
    PendingConfirmation,
    differences,
)
from oculus_driver.link.driver import LinkDriver
from oculus_driver.link.machine import Link
from oculus_driver.link.ping_queue import MAX_PINGS, PingQueue
from oculus_driver.link.state import SECOND_NS, LinkState, LinkStatus, LinkTimeouts
from oculus_driver.models import UNKNOWN, model_of
from oculus_driver.settings import FireSettings
from oculus_driver.status import Status, ThermalGuard
from oculus_driver.wire import TCP_PORT, MessageId, PingRate

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from types import TracebackType

    from oculus_driver.discovery.listener import Announcement, DiscoveryFactory
    from oculus_driver.link.confirmation import Difference
    from oculus_driver.link.receiver import ReceivedMessage
    from oculus_driver.link.state import SonarCounters
    from oculus_driver.models import Model
    from oculus_driver.ping import Ping, PingHeader
    from oculus_driver.stream import Framing, MessageBounds

_LOG: Final = logging.getLogger(__name__)
STANDBY_TIMEOUT_S: Final = 1.0
_POLL_INTERVAL_S: Final = 0.01
"""Interval of checks whether settings were sent: a fraction of the gap between two messages."""


class OculusSonar:
    """One Oculus sonar within an `async with` block.

    The driver keeps the link up; `state` and `link` report its state. `pings` delivers the pings; a
    slow reader loses old pings, never the link. At the end of the block the sonar is put into
    standby. A sonar serves one client at a time.

    Args:
        host: address of the sonar; None: discover it by its status.
        settings: initial settings; None: standby until `apply`. A sonar that pings in air
            overheats.
        serial: serial number (device id) of the sonar to use; None: the first one discovered.
        model: if it is known and `host` is given; otherwise it is learned from received messages.
        port: of the data connection.
        version: of the fire messages; None: 2 with fallback to 1.
        times: timeouts of the link.
        max_pings: maximum number of queued pings.
        max_temperature_c: above this the sonar is held in standby until its status shows 3 °C less
            or, if its address was given, until `release`. None: only the sonar's own limit.
        keep_pinging: leave the sonar pinging at the end.
        on_bytes: called with all received bytes before they are parsed, and their arrival time.
        on_chunk: called with the same bytes and time after they are parsed, and with the message
            boundaries in them, as `oculus_driver.recording.SonarLog.write` needs them.
        on_framing: called with the same bytes and time after they are parsed, and with the messages
            that they complete, so that the caller need not parse them again.
        on_status: called with each status datagram of the sonar and its arrival time. With `host`
            it is listened for only if this is given; a port that cannot be opened is logged.
        on_state: called with each change of the link's state or reason.
        discovery: source of statuses; None: `oculus_driver.discovery.listener.Discovery`.
        clock: host monotonic time, nanoseconds.
        rng: random numbers from 0 to 1.
    """

    def __init__(
        self,
        host: str | None = None,
        settings: FireSettings | None = None,
        *,
        serial: int | None = None,
        model: Model | None = None,
        port: int = TCP_PORT,
        version: int | None = None,
        times: LinkTimeouts | None = None,
        max_pings: int = MAX_PINGS,
        max_temperature_c: float | None = None,
        keep_pinging: bool = False,
        on_bytes: Callable[[bytes, int], None] | None = None,
        on_chunk: Callable[[bytes, int, MessageBounds], object] | None = None,
        on_framing: Callable[[bytes, int, Framing], object] | None = None,
        on_status: Callable[[bytes, int], object] | None = None,
        on_state: Callable[[LinkStatus], None] | None = None,
        discovery: DiscoveryFactory | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
        rng: Callable[[], float] = random.random,
    ) -> None:
        self._requested = settings or FireSettings(ping_rate=PingRate.STANDBY)
        self._applied = self._requested
        self._model = model
        self._clock = clock
        self._keep_pinging = keep_pinging
        self._on_state = on_state
        self._on_status = on_status
        self._queue = PingQueue(max_pings)
        self._search = SonarSearch(serial, discovery) if host is None else None
        self._statuses: SonarSearch | None = None
        if host is not None and on_status is not None:
            self._statuses = SonarSearch(serial, discovery, host)
        self._thermal = ThermalGuard(max_temperature_c)
        self._holds: dict[str, str] = {}
        self._last_ping: PingHeader | None = None
        self._ping_waiters: set[asyncio.Future[PingHeader]] = set()
        self._confirmations: dict[asyncio.Future[Confirmation], PendingConfirmation] = {}
        self._state_waiters: dict[asyncio.Future[LinkState], tuple[LinkState, ...]] = {}
        self._standby_seen: asyncio.Future[None] | None = None
        self._entered = False
        link = Link(self._limited_settings(), address=host, version=version, times=times, rng=rng)
        self._driver = LinkDriver(
            link,
            port=port,
            clock=clock,
            on_bytes=on_bytes,
            on_chunk=on_chunk,
            on_framing=on_framing,
            on_received=self._received,
            on_status=self._link_changed,
            on_failure=self._failed,
        )

    @property
    def state(self) -> LinkState:
        """State of the link."""
        return self._driver.link.status.state

    @property
    def link(self) -> LinkStatus:
        """State of the link with reason, start time, address and fire version."""
        return self._driver.link.status

    @property
    def settings(self) -> FireSettings:
        """The last requested settings."""
        return self._requested

    @property
    def limited(self) -> FireSettings:
        """The settings as sent: the requested ones with the range limited to the model's."""
        return self._requested if self._model is None else self._requested.limited_to(self._model)

    @property
    def status(self) -> Status | None:
        """The sonar's last status, None if its address was given."""
        return None if self._search is None else self._search.status

    @property
    def model(self) -> Model | None:
        """Model of the sonar, None until it is known."""
        return self._model

    @property
    def changed(self) -> tuple[Difference, ...]:
        """Differences between the last ping and the requested settings."""
        ping = self._last_ping
        return () if ping is None or self._requested.standby else differences(self._requested, ping)

    @property
    def counters(self) -> SonarCounters:
        """All counters."""
        return self._driver.counters(
            taken=self._queue.taken, dropped=self._queue.dropped, queued=len(self._queue)
        )

    def pings(self) -> AsyncIterator[Ping]:
        """Return an iterator over pings that ends when the sonar is closed.

        A ping is decoded when a reader takes it; several readers share the pings. Exceptions of
        the callbacks and the discovery are raised here, and at the end of the `async with` block.
        """
        return self._queue

    async def apply(
        self, settings: FireSettings, timeout_s: float = CONFIRM_TIMEOUT_NS / SECOND_NS
    ) -> Confirmation:
        """Request settings, now and after every reconnection, and wait for their confirmation.

        Changed settings are waited for where pings show them, even if they are not decisive. A
        missing confirmation is not an error: the link keeps requesting the settings.

        Raises:
            SettingsError: the model does not have the mode.
            LinkError: the sonar was closed in the meantime.
        """
        limited = self._limit(settings)
        self._requested = settings
        now_ns = self._clock()
        self._driver.do(self._driver.link.apply(limited, now_ns))
        sent = limited.in_standby() if limited.network_trigger else limited
        pending = PendingConfirmation(settings, now_ns, sent, before=self._applied)
        future: asyncio.Future[Confirmation] = asyncio.get_running_loop().create_future()
        self._confirmations[future] = pending
        try:
            async with asyncio.timeout(timeout_s):
                confirmation = await future
        except TimeoutError:
            confirmation = pending.expire(self._clock())
        finally:
            del self._confirmations[future]
        if not sent.standby:  # no ping shows settings in standby
            self._applied = limited
        return confirmation

    async def standby(self) -> Confirmation:
        """Put the sonar into standby and wait for the confirmation."""
        return await self.apply(replace(self._requested, ping_rate=PingRate.STANDBY))

    async def fire(self, timeout_s: float = 3.0) -> Ping:
        """Trigger one ping (`FireSettings.network_trigger`) and return it.

        The readers of `pings` get the ping, too.

        Raises:
            SettingsError: the sonar is not in triggered mode.
            LinkError: the sonar cannot fire now, or no ping arrived in time.
        """
        if not self._requested.network_trigger:
            raise SettingsError("fire() needs network_trigger=True: apply such settings first")
        link = self._driver.link
        future: asyncio.Future[PingHeader] = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(timeout_s):
                while link.has_unsent:  # noqa: ASYNC110 - the link has no event for sent settings
                    await asyncio.sleep(_POLL_INTERVAL_S)
                if not link.can_trigger:
                    raise LinkError(f"the sonar cannot fire now: {link.status.reason}")
                self._ping_waiters.add(future)
                self._driver.do(link.trigger(self._clock()))
                return (await future).decode()
        except TimeoutError:
            raise LinkError(f"no ping within {timeout_s:g} s of the trigger") from None
        finally:
            self._ping_waiters.discard(future)

    def hold(self, reason: str) -> None:
        """Keep the sonar in standby until `release`, for example out of the water."""
        self._hold("user", reason)

    def release(self) -> None:
        """End the `hold`, and a thermal one; the latter returns if the sonar is still hot."""
        self._thermal.reason = None
        self._hold("thermal", None)
        self._hold("user", None)

    async def wait_for(self, *states: LinkState) -> LinkState:
        """Wait until the link is, or was for a moment, in one of the states; return that state.

        Raises:
            LinkError: the sonar was closed in the meantime.
        """
        if self.state in states:
            return self.state
        future: asyncio.Future[LinkState] = asyncio.get_running_loop().create_future()
        self._state_waiters[future] = states
        try:
            return await future
        finally:
            del self._state_waiters[future]

    async def __aenter__(self) -> Self:
        if self._entered:
            raise LinkError("a sonar can be opened only once: create another OculusSonar")
        self._entered = True
        self._driver.start()
        if self._search is not None:
            self._search.start(self._sonar_found, self._failed)
        if self._statuses is not None:
            self._statuses.start(self._pass_status, self._statuses_failed)
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            for search in (self._search, self._statuses):
                if search is not None:
                    await search.stop()
            await self._enter_standby()
        finally:
            self._fail_waiters(LinkError("the sonar was closed"))
            self._queue.close()
            await self._driver.close("closed by the caller")
        if error is None and self._driver.failure is not None:
            raise self._driver.failure

    # Callbacks of the link and the search.

    def _received(self, received: ReceivedMessage, now_ns: int) -> None:
        if received.message_id == MessageId.DUMMY:
            if self._standby_seen is not None and not self._standby_seen.done():
                self._standby_seen.set_result(None)
            self._resolve_confirmations(lambda pending: pending.dummy(now_ns))
        ping = received.ping
        if ping is None:
            return
        if self._model is None and ping.part_number:
            self._set_model(model_of(ping.part_number))
        self._thermal.ping(ping)
        self._hold("thermal", self._thermal.reason)
        self._last_ping = ping
        self._queue.put(ping)
        self._resolve_confirmations(lambda pending: pending.ping(ping, now_ns))
        for future in self._ping_waiters:
            if not future.done():
                future.set_result(ping)

    def _resolve_confirmations(
        self, ask: Callable[[PendingConfirmation], Confirmation | None]
    ) -> None:
        for future, pending in self._confirmations.items():
            confirmation = ask(pending)
            if confirmation is not None and not future.done():
                future.set_result(confirmation)

    def _pass_status(self, found: Announcement) -> None:
        if self._on_status is not None:
            self._on_status(found.status.datagram, self._clock())

    def _statuses_failed(self, error: BaseException) -> None:
        if isinstance(error, DiscoveryError):
            _LOG.warning("statuses of the sonar are not received: %s", error)
        else:
            self._failed(error)

    def _sonar_found(self, found: Announcement) -> None:
        self._pass_status(found)
        status = found.status
        if self._model is None:
            self._set_model(status.model)
        self._thermal.status(status)
        self._hold("thermal", self._thermal.reason)
        client = status.client_address
        holder = str(client) if client else "another client" if status.busy else None
        now_ns = self._clock()
        self._driver.do(self._driver.link.discovered(found.address, now_ns, holder=holder))

    def _set_model(self, model: Model) -> None:
        self._model = model
        if model.family == UNKNOWN:
            _LOG.warning("unknown model %s: its limits are not checked", model.name)
        limited = self._limited_settings()
        if limited != self._requested:
            self._driver.do(self._driver.link.apply(limited, self._clock()))

    def _limited_settings(self) -> FireSettings:
        return self._limit(self._requested)

    def _limit(self, settings: FireSettings) -> FireSettings:
        limited = settings if self._model is None else settings.limited_to(self._model)
        if limited != settings and self._model is not None:
            words = "range %s m is limited to %s m, the maximum of %s in mode %d"
            name = self._model.name
            _LOG.warning(words, settings.range_m, limited.range_m, name, settings.mode)
        return limited

    def _hold(self, who: str, reason: str | None) -> None:
        if reason == self._holds.get(who):
            return
        if reason is None:
            self._holds.pop(who, None)
        else:
            self._holds[who] = reason
        first = next(iter(self._holds.values()), None)
        self._driver.do(self._driver.link.hold(first, self._clock()))

    def _link_changed(self, status: LinkStatus) -> None:
        _LOG.info("%s: %s (%s)", status.address or "sonar", status.state, status.reason)
        for future, states in self._state_waiters.items():
            if status.state in states and not future.done():
                future.set_result(status.state)
        if self._on_state is not None:
            self._on_state(status)

    def _failed(self, error: BaseException) -> None:
        """Close after an error of this program: readers and the block get it."""
        self._driver.fail(error)
        self._queue.close(error)
        self._fail_waiters(error)

    # Closing.

    async def _enter_standby(self) -> None:
        """Request standby and wait a moment for the sonar's confirmation."""
        if self._keep_pinging or not self._driver.is_connected:
            return
        self._standby_seen = asyncio.get_running_loop().create_future()
        self._hold("close", "closing")
        closed = self._driver.connection_closed
        await asyncio.wait(
            (self._standby_seen, closed),
            timeout=STANDBY_TIMEOUT_S,
            return_when=asyncio.FIRST_COMPLETED,
        )

    def _fail_waiters(self, error: BaseException) -> None:
        waiting: list[asyncio.Future[Any]] = [*self._ping_waiters, *self._confirmations]
        for future in (*waiting, *self._state_waiters):
            if not future.done():
                future.set_exception(error)
