"""A sonar on the network: its link kept up, its pings handed on, its settings asked for."""

from __future__ import annotations

import asyncio
import logging
import random
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Self

from oculus_driver.discovery.listener import Search
from oculus_driver.errors import LinkError, SettingsError
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
from oculus_driver.link.thermal import ThermalGuard
from oculus_driver.models import UNKNOWN, model_of
from oculus_driver.settings import FireSettings
from oculus_driver.wire import TCP_PORT, MessageId, PingRate

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from types import TracebackType

    from oculus_driver.discovery.listener import Announcement, DiscoveryFactory
    from oculus_driver.link.confirmation import Difference
    from oculus_driver.link.receiver import ReceivedMessage
    from oculus_driver.link.state import SonarCounters
    from oculus_driver.models import Model
    from oculus_driver.ping import Ping
    from oculus_driver.status import Status

_LOG: Final = logging.getLogger(__name__)
STANDBY_TIMEOUT_S: Final = 1.0
_POLL_INTERVAL_S: Final = 0.01
"""Between looks at whether settings have gone out: a fraction of the gap between two messages."""


class OculusSonar:
    """One Oculus sonar, for the time of an `async with` block.

    The link is kept up whatever happens: `state` and `link` say what it does. Pings are taken
    from `pings`; a reader that is slow loses old ones, never the link. When the block ends the
    sonar is put into standby. One sonar serves one client at a time.

    Args:
        host: the sonar's address, None to find it by its status.
        settings: what it shall do; None: standby, until `apply` says otherwise. A sonar that
            pings in air gets hot.
        serial: the sonar's device id, to choose among several; without it the first one heard.
        model: where it is known and `host` is given; else it is learned from what is received.
        port: of the data connection.
        version: of the fire messages, None for 2 with fallback to 1.
        times: how long the link waits for what.
        max_pings: held for readers at most.
        max_temperature_c: the sonar is held in standby above, and until its status shows 3 °C
            less; where its address was given, until `release`. None: by its own limit alone.
        keep_pinging: leave the sonar pinging at the end.
        on_bytes: called with all bytes before they are parsed, and their arrival time.
        on_state: called whenever the link enters a state or has another reason.
        discovery: where statuses come from, None for `oculus_driver.discovery.listener`.
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
        on_state: Callable[[LinkStatus], None] | None = None,
        discovery: DiscoveryFactory | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
        rng: Callable[[], float] = random.random,
    ) -> None:
        self._requested = settings or FireSettings(ping_rate=PingRate.STANDBY)
        self._model = model
        self._clock = clock
        self._keep_pinging = keep_pinging
        self._on_state = on_state
        self._queue = PingQueue(max_pings)
        self._search = Search(serial, discovery) if host is None else None
        self._thermal = ThermalGuard(max_temperature_c)
        self._holds: dict[str, str] = {}
        self._last_ping: Ping | None = None
        self._ping_waiters: set[asyncio.Future[Ping]] = set()
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
            on_received=self._received,
            on_status=self._link_changed,
            on_failure=self._failed,
        )

    @property
    def state(self) -> LinkState:
        """What the link does now."""
        return self._driver.link.status.state

    @property
    def link(self) -> LinkStatus:
        """The link's state with its reason, since when, address and fire version."""
        return self._driver.link.status

    @property
    def settings(self) -> FireSettings:
        """What was asked for last."""
        return self._requested

    @property
    def status(self) -> Status | None:
        """The sonar's last status; none where its address was given."""
        return None if self._search is None else self._search.status

    @property
    def model(self) -> Model | None:
        """Which sonar it is, once known."""
        return self._model

    @property
    def changed(self) -> tuple[Difference, ...]:
        """What the last ping shows otherwise than asked for."""
        ping = self._last_ping
        return () if ping is None or self._requested.standby else differences(self._requested, ping)

    @property
    def counters(self) -> SonarCounters:
        """All counts so far."""
        return self._driver.counters(
            taken=self._queue.taken, dropped=self._queue.dropped, queued=len(self._queue)
        )

    def pings(self) -> AsyncIterator[Ping]:
        """Return the pings as they come, until the sonar is closed.

        Several readers share them. What goes wrong in `on_bytes`, `on_state` or the search is
        raised here, and at the end of the `async with` block.
        """
        return self._queue

    async def apply(
        self, settings: FireSettings, timeout_s: float = CONFIRM_TIMEOUT_NS / SECOND_NS
    ) -> Confirmation:
        """Ask for settings, now and after every reconnection, and wait for what pings show.

        Not confirmed is an answer, not an error: the link stays and keeps asking.

        Raises:
            SettingsError: the model has not got the mode.
            LinkError: the sonar was closed meanwhile.
        """
        limited = self._limit(settings)
        self._requested = settings
        now_ns = self._clock()
        self._driver.do(self._driver.link.apply(limited, now_ns))
        sent = limited.in_standby() if limited.network_trigger else limited
        pending = PendingConfirmation(settings, now_ns, sent)
        future: asyncio.Future[Confirmation] = asyncio.get_running_loop().create_future()
        self._confirmations[future] = pending
        try:
            async with asyncio.timeout(timeout_s):
                return await future
        except TimeoutError:
            return pending.expire(self._clock())
        finally:
            del self._confirmations[future]

    async def standby(self) -> Confirmation:
        """Make the sonar quiet and wait for a sign that it is."""
        return await self.apply(replace(self._requested, ping_rate=PingRate.STANDBY))

    async def fire(self, timeout_s: float = 3.0) -> Ping:
        """Trigger one ping (`FireSettings.network_trigger`) and return it.

        The ping goes to readers of `pings` as well.

        Raises:
            SettingsError: the sonar is not in triggered mode.
            LinkError: it cannot be fired now, or no ping came in time.
        """
        if not self._requested.network_trigger:
            raise SettingsError("fire() needs settings with network_trigger=True: apply them first")
        link = self._driver.link
        future: asyncio.Future[Ping] = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(timeout_s):
                while link.has_unsent:  # noqa: ASYNC110 right-before settings; nobody tells when they went
                    await asyncio.sleep(_POLL_INTERVAL_S)
                if not link.can_trigger:
                    raise LinkError(f"the sonar cannot be fired now: {link.status.reason}")
                self._ping_waiters.add(future)
                self._driver.do(link.trigger(self._clock()))
                return await future
        except TimeoutError:
            raise LinkError(f"no ping within {timeout_s:g} s of the trigger") from None
        finally:
            self._ping_waiters.discard(future)

    def hold(self, reason: str) -> None:
        """Keep the sonar quiet, whatever is asked for, until `release`: out of the water, say."""
        self._hold("user", reason)

    def release(self) -> None:
        """End the `hold`, and one for heat: it comes back where the sonar is still hot."""
        self._thermal.reason = None
        self._hold("thermal", None)
        self._hold("user", None)

    async def wait_for(self, *states: LinkState) -> LinkState:
        """Wait until the link is, or was for a moment, in one of the states; return which.

        Raises:
            LinkError: the sonar was closed meanwhile.
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
            raise LinkError("a sonar can be opened once: make another OculusSonar")
        self._entered = True
        self._driver.start()
        if self._search is not None:
            self._search.start(self._sonar_found, self._failed)
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if self._search is not None:
                await self._search.stop()
            await self._enter_standby()
        finally:
            self._fail_waiters(LinkError("the sonar was closed"))
            self._queue.close()
            await self._driver.close("closed by the caller")
        if error is None and self._driver.failure is not None:
            raise self._driver.failure

    # What the link, the search and the bytes bring.

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

    def _sonar_found(self, found: Announcement) -> None:
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
            _LOG.warning("%s is not known: its limits are not checked", model.name)
        limited = self._limited_settings()
        if limited != self._requested:
            self._driver.do(self._driver.link.apply(limited, self._clock()))

    def _limited_settings(self) -> FireSettings:
        return self._limit(self._requested)

    def _limit(self, settings: FireSettings) -> FireSettings:
        limited = settings if self._model is None else settings.limited_to(self._model)
        if limited != settings and self._model is not None:
            words = "range %s m is cut to %s m, the farthest of %s in mode %d"
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
        """End after an error that is not the sonar's: readers and the block get it."""
        self._driver.fail(error)
        self._queue.close(error)
        self._fail_waiters(error)

    # The end.

    async def _enter_standby(self) -> None:
        """Ask for standby, and give the sonar a moment to say that it is quiet."""
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
