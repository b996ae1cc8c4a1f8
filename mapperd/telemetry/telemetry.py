"""The link to the broker: comes back by itself, and costs a counter while it is gone.

connecting ─▶ connected
   ▲   │          │
   │   └────▼─────┘  (refused, unreachable, lost)
   └─ backing off

Requests come through it: commands and changes of settings, each with its answer.
"""

import asyncio
import os
import random
import time
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mapperd.api import DaemonApi, OperationError, PoseRequest
from mapperd.config.live import Refused
from mapperd.errors import ConfigError, MapperdError
from mapperd.events import Severity
from mapperd.telemetry.broker import Kind, Outbox, QueuedMessage, check_telemetry, connection
from mapperd.telemetry.payloads import encoded
from mapperd.telemetry.publisher import Reporter, Vitals
from mapperd.telemetry.topics import Asked, Topics
from oculus_driver.back_off import BackOff, doubling_steps

if TYPE_CHECKING:
    from aiomqtt import Client

__all__ = [
    "ORIGIN",
    "Phase",
    "Telemetry",
    "TelemetryRequests",
]

ORIGIN = "mqtt"

MAX_WAITING = 16
MAX_BYTES = 4096
MAX_ID = 64
MAX_NUMBER = 2**63
REMEMBERED = 64
"""Answers by request id, so that a request that comes twice is done once."""

WITH_ARGUMENTS = ("save", "initial_pose", "set_map")

Id = str | int | None
Answer = dict[str, Any]


class _BadRequestError(Exception):
    """What was sent is no request."""


@dataclass(frozen=True, slots=True)
class _PendingAnswer:
    asked: Asked
    id: Id
    body: Any


class TelemetryRequests:
    """Obeys one request after the other.

    Args:
        operations: the daemon.
        topics: where requests come from and answers go to.
        put: takes the answers.

    Attributes:
        counts: `done`, `refused`, `repeated`; of those that get no answer `retained` (a broker's
            memory is no wish, nor is clearing it), `no_request` (nothing we know the name of)
            and `too_many`.
    """

    def __init__(
        self, operations: DaemonApi, topics: Topics, put: Callable[[QueuedMessage], None]
    ) -> None:
        self._operations = operations
        self._topics = topics
        self._put = put
        self._waiting: asyncio.Queue[_PendingAnswer] = asyncio.Queue(MAX_WAITING)
        self._answers: OrderedDict[tuple[Asked, Id], bytes] = OrderedDict()
        self.counts: Counter[str] = Counter()

    def offer(self, topic: str, payload: bytes, *, retained: bool) -> None:
        """Take a message that came; never waits."""
        asked = self._topics.asked(topic)
        if asked is None:
            self.counts["no_request"] += 1
        elif retained or not payload:  # nothing is what takes a retained message away
            self.counts["retained"] += 1
        elif self._waiting.full():
            self.counts["too_many"] += 1
        else:
            try:
                request = _request(asked, payload)
            except _BadRequestError as error:
                self._answer(asked, None, _refusal("bad_request", str(error)))
            else:
                self._waiting.put_nowait(request)

    async def work(self) -> None:
        """Obey, until cancelled."""
        while True:
            request = await self._waiting.get()
            known = self._answers.get((request.asked, request.id))
            if known is not None and request.id is not None:
                self.counts["repeated"] += 1
                self._publish(request.asked, known)
                continue
            self._answer(request.asked, request.id, await self._obeyed(request))

    async def _obeyed(self, request: _PendingAnswer) -> Answer:
        try:
            if request.asked.kind == "config":
                return await asyncio.to_thread(self._set, request.asked.name, request.body)
            return {"ok": True, "result": await self._command(request.asked.name, request.body)}
        except _BadRequestError as error:
            return _refusal("bad_request", str(error))
        except OperationError as error:
            return _refusal(error.reason, str(error))
        except MapperdError as error:
            return _refusal("refused", str(error))
        except Exception as error:  # noqa: BLE001 a fault of ours costs the request, not the daemon
            return _refusal("internal_error", f"{type(error).__name__}: {error}")

    def _set(self, name: str, value: object) -> Answer:
        """In a thread: who follows a setting may wait for the end of a ping."""
        result = self._operations.settings.apply({name: value}, ORIGIN)
        if isinstance(result, Refused):
            reasons = "; ".join(f"{where}: {why}" for where, why in result.reasons.items())
            return _refusal("refused", reasons)
        return {"ok": True, "value": value}

    def _command(self, name: str, body: Mapping[str, Any]) -> Awaitable[dict[str, Any]]:
        operations = self._operations
        plain = {
            "reset": operations.reset,
            "clear": operations.reset,
            "reload": operations.reload,
            "snapshot": operations.snapshot,
            "global_localization": operations.global_localization,
            "request_nomotion_update": operations.request_nomotion_update,
        }
        if name in plain:
            _allow(body)
            return plain[name](ORIGIN)
        match name if name in WITH_ARGUMENTS else self._topics.also.get(name):
            case "save":
                _allow(body, "name")
                return operations.save(_text(body, "name"), ORIGIN)
            case "initial_pose":
                _allow(body, "pose")
                return operations.initial_pose(_pose(body), ORIGIN)
            case "set_map":
                _allow(body, "name", "pose")
                pose = _pose(body) if "pose" in body else None
                return operations.set_map(_text(body, "name"), pose, ORIGIN)
        known = ", ".join([*WITH_ARGUMENTS, *plain])
        raise OperationError(f"there is no such command; there are {known}", "unknown_command")

    def _answer(self, asked: Asked, request_id: Id, answer: Answer) -> None:
        self.counts["done" if answer["ok"] else "refused"] += 1
        payload = encoded({"id": request_id, **answer})
        if request_id is not None:
            self._answers[asked, request_id] = payload
            if len(self._answers) > REMEMBERED:
                self._answers.popitem(last=False)
        self._publish(asked, payload)

    def _publish(self, asked: Asked, payload: bytes) -> None:
        self._put(QueuedMessage(self._topics.result(asked), payload, Kind.ANSWER, qos=1))


def _request(asked: Asked, payload: bytes) -> _PendingAnswer:
    """Read a payload: of a command an object with an id, of a setting a value or such an object."""
    if len(payload) > MAX_BYTES:
        raise _BadRequestError(f"{len(payload)} bytes; at most {MAX_BYTES}")
    try:
        body = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _BadRequestError(f"not JSON: {error}") from error
    if asked.kind == "config":
        if isinstance(body, dict) and "value" in body:
            _allow(body, "id", "value")
            return _PendingAnswer(asked, _id_of(body), body["value"])
        return _PendingAnswer(asked, None, body)
    if not isinstance(body, dict) or body.get("id") is None:
        raise _BadRequestError('an object with an "id" of your choice is wanted')
    request_id = _id_of(body)
    return _PendingAnswer(asked, request_id, {key: one for key, one in body.items() if key != "id"})


def _id_of(body: Mapping[str, Any]) -> Id:
    request_id = body.get("id")
    if isinstance(request_id, bool) or not isinstance(request_id, str | int | None):
        raise _BadRequestError("id: a text or a whole number is wanted")
    if isinstance(request_id, int) and abs(request_id) >= MAX_NUMBER:
        raise _BadRequestError("id: at most 63 bits")
    if len(str(request_id)) > MAX_ID:
        raise _BadRequestError(f"id: at most {MAX_ID} characters")
    return request_id


def _pose(body: Mapping[str, Any]) -> PoseRequest:
    try:
        return msgspec.convert(body.get("pose"), PoseRequest)
    except msgspec.ValidationError as error:
        raise _BadRequestError(f"pose: {error}") from error


def _text(body: Mapping[str, Any], key: str) -> str:
    if not isinstance(body.get(key), str):
        raise _BadRequestError(f"{key}: expected a string")
    return str(body[key])


def _allow(body: Mapping[str, Any], *keys: str) -> None:
    for key in body:
        if key not in keys:
            raise _BadRequestError(f"{key[:60]}: is not known here")


def _refusal(reason: str, text: str) -> Answer:
    return {"ok": False, "reason": reason, "text": text}


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
