"""The link to the broker: comes back by itself, and costs a counter while it is gone.

connecting ─▶ connected
   ▲   │          │
   │   └────▼─────┘  (refused, unreachable, lost)
   └─ backing off
"""

import asyncio
import os
import random
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapperd.api import DaemonApi
from mapperd.errors import ConfigError
from mapperd.events import Severity
from mapperd.telemetry.broker import check_telemetry, connection
from mapperd.telemetry.outbox import Kind, Outbox, QueuedMessage
from mapperd.telemetry.publisher import Reporter, Vitals
from mapperd.telemetry.requests import TelemetryRequests
from mapperd.telemetry.topics import Topics
from oculus_driver.back_off import BackOff, doubling_steps

if TYPE_CHECKING:
    from aiomqtt import Client

__all__ = ["Phase", "Telemetry"]

RETRY_DELAY_S, MAX_RETRY_DELAY_S = 2.0, 30.0
SOUND_S = 30.0
"""A connection that lasted this long was good: the next attempt follows soon."""

GOODBYE_S = 2.0
"""For the last messages, when the daemon ends."""

CANCEL_S = 0.1
"""Between cancellations of what has not heard the one before."""

REFUSED = 128
"""A subscription's answer from here on is a refusal."""

SENDERS = ((Kind.ANSWER, Kind.EVENT), (Kind.STATE,), (Kind.TELEMETRY,))
"""Kinds that are sent one after the other; no kind waits for those of another sender."""


class Phase(StrEnum):
    """What the link does."""

    CLOSED = "closed"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    BACKING_OFF = "backing off"


class Telemetry:
    """Publishes the daemon's state to a broker, and accepts requests if `mqtt.commands` is on.

    Lives in the daemon's event loop, and never lets it wait.

    Args:
        operations: the daemon.
        folders: folders whose free space is reported.
        environment: gives the systemd credentials directory.
        clock: Unix time in nanoseconds that is never set back.
        chance: random numbers from 0 to 1.

    Raises:
        ConfigError: as `check_telemetry`.

    Attributes:
        phase: what the link does.
        reason: why.
        counts: `connected`, `lost` (or refused, or unreachable), `published`, `failed`.
    """

    FOLLOWS = ("mqtt.pose_rate",)
    """Live settings of its own."""

    def __init__(
        self,
        operations: DaemonApi,
        folders: Iterable[Path] = (),
        environment: Mapping[str, str] = os.environ,
        clock: Callable[[], int] = time.time_ns,
        chance: Callable[[], float] = random.random,
    ) -> None:
        config = operations.settings.current
        check_telemetry(config, environment)
        self._operations = operations
        self._settings = config.mqtt
        self._environment = environment
        self._clock = clock
        self._topics = Topics.of(config.mqtt, config.amcl)
        self._outbox = Outbox(config.mqtt.queue)
        vitals = Vitals(folders)
        self._reporter = Reporter(operations, self._topics, self._outbox, vitals, self.status)
        self._requests = TelemetryRequests(operations, self._topics, self._put)
        self._back_off = BackOff(doubling_steps(RETRY_DELAY_S, MAX_RETRY_DELAY_S), chance)
        self._news = [asyncio.Event() for _ in SENDERS]
        self.phase, self.reason = Phase.CLOSED, "not started"
        self.counts = dict.fromkeys(("connected", "lost", "published", "failed"), 0)
        operations.settings.follow(self.FOLLOWS, lambda _: None)  # read again when needed

    def status(self) -> dict[str, Any]:
        """The link in plain values; from any thread."""
        return {
            "phase": str(self.phase),
            "reason": self.reason,
            "broker": f"{self._settings.host}:{self._settings.port}",
            **self.counts,
            "queue": len(self._outbox),
            "dropped": {kind.name.lower(): n for kind, n in self._outbox.dropped.items()},
            "events_missed": self._reporter.events_missed,
            "requests": dict(self._requests.counts),
        }

    async def run(self) -> None:
        """Publish until cancelled, then publish `offline`."""
        work = asyncio.create_task(self._requests.work())
        try:
            while True:
                connected_s = await self._one_connection()
                _stop_if_cancelled()  # an error on the way out may have taken its place
                if connected_s >= SOUND_S:
                    self._back_off.succeeded()
                pause_s = self._back_off.failed()
                self.phase = Phase.BACKING_OFF
                await asyncio.sleep(pause_s)
        finally:
            self.phase, self.reason = Phase.CLOSED, "stopped"
            work.cancel()
            await asyncio.gather(work, return_exceptions=True)

    async def _one_connection(self) -> float:
        """Connect and publish until the connection breaks; return its duration in seconds."""
        from aiomqtt import MqttError  # noqa: PLC0415 an extra

        self.phase = Phase.CONNECTING
        began_ns: int | None = None
        try:
            async with connection(self._settings, self._environment) as client:
                await self._greet(client)
                _stop_if_cancelled()
                began_ns = self._clock()
                self._log_connected()
                try:
                    await _first_of(*self._works(client))
                except asyncio.CancelledError:
                    await self._publish_offline(client)
                    raise
        except (MqttError, OSError, ConfigError) as error:
            self._log_lost(str(error) or type(error).__name__, was_connected=began_ns is not None)
        except Exception as error:  # noqa: BLE001 a fault in here costs telemetry, never the dive
            self._log_lost(f"{type(error).__name__}: {error}", was_connected=began_ns is not None)
        self._outbox.forget_what_passes()
        return 0.0 if began_ns is None else (self._clock() - began_ns) / 1e9

    async def _greet(self, client: "Client") -> None:
        """Subscribe, then publish `online`, so that requests sent on it are received."""
        if self._settings.commands:
            granted = await client.subscribe([(topic, 1) for topic in self._topics.requests])
            codes = [code if isinstance(code, int) else code.value for code in granted]
            if any(code >= REFUSED for code in codes):
                self._event(Severity.WARNING, "mqtt_commands", "the broker allows no commands")
        await client.publish(self._topics.of_name("status"), b"online", qos=1, retain=True)

    def _works(self, client: "Client") -> list[Awaitable[Any]]:
        self._reporter.renew()
        senders = [
            self._send(client, news, *kinds)
            for news, kinds in zip(self._news, SENDERS, strict=True)
        ]
        return [self._listen(client), self._report(), *senders]

    async def _report(self) -> None:
        while True:
            self._reporter.collect(self._clock() / 1e9)
            self._wake()
            await asyncio.sleep(self._reporter.period_s)

    async def _send(self, client: "Client", news: asyncio.Event, *kinds: Kind) -> None:
        while True:
            message = self._outbox.take(*kinds)
            if message is None:
                news.clear()
                await news.wait()
            else:
                await self._publish(client, message)

    async def _publish(self, client: "Client", message: QueuedMessage) -> None:
        try:
            await client.publish(
                message.topic, message.payload, qos=message.qos, retain=message.retain
            )
        except BaseException:
            self.counts["failed"] += 1
            self._outbox.put_back(message)
            raise
        self.counts["published"] += 1

    async def _listen(self, client: "Client") -> None:
        """Take requests; without commands nothing comes, but the end of the connection."""
        async for message in client.messages:
            payload = message.payload if isinstance(message.payload, bytes) else b""
            self._requests.offer(str(message.topic), payload, retained=bool(message.retain))

    async def _publish_offline(self, client: "Client") -> None:
        """Publish `offline` after the last events: a broker sends no will after a clean end."""
        with suppress(Exception):
            async with asyncio.timeout(GOODBYE_S):
                self._reporter.collect_events()
                while (message := self._outbox.take(Kind.ANSWER, Kind.EVENT)) is not None:
                    await self._publish(client, message)
        with suppress(Exception):
            async with asyncio.timeout(GOODBYE_S):
                status = self._topics.of_name("status")
                await client.publish(status, b"offline", qos=1, retain=True)

    def _put(self, message: QueuedMessage) -> None:
        self._outbox.put(message)
        self._wake()

    def _wake(self) -> None:
        for news in self._news:
            news.set()

    def _log_connected(self) -> None:
        self.phase, self.reason = Phase.CONNECTED, "the broker accepted us"
        self.counts["connected"] += 1
        self._event(Severity.NOTICE, "mqtt_link", "the broker is connected")

    def _log_lost(self, why: str, *, was_connected: bool) -> None:
        """Count; an event only where something changed, not for every attempt."""
        if was_connected or why != self.reason:
            self._event(Severity.WARNING, "mqtt_link", f"the broker is lost: {why}")
        self.reason = why
        self.counts["lost"] += 1

    def _event(self, severity: Severity, code: str, text: str) -> None:
        self._operations.events.add(severity, code, text)


def _stop_if_cancelled() -> None:
    """Raise a cancellation again that `asyncio.wait_for` has lost, as it may before Python 3.12."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


async def _first_of(*works: Awaitable[Any]) -> None:
    """Run until one of these ends, cancel the others, and raise what it raised."""
    tasks = {asyncio.ensure_future(work) for work in works}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        pending = {task for task in tasks if not task.done()}
        while pending:  # each may lose a cancellation, as above
            for task in pending:
                task.cancel()
            _, pending = await asyncio.wait(pending, timeout=CANCEL_S)
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()
