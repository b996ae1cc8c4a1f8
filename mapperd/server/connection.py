"""One connection of a client: reads its bytes, sends messages, carries out requests in order."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from mapperd.api import DaemonApi, OperationError
from mapperd.config.catalog import value_of
from mapperd.config.live import ConfigStore, Refused, chosen, facts_of
from mapperd.events import EventLog, Severity
from mapperd.server.pacer import tcp_state
from mapperd.server.session import ClientSession, ResumeState
from mapperd.wire.auth import Limits, TokenBucket
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import MAX_FROM_SERVER
from mapperd.wire.requests import (
    EventsRequest,
    Fault,
    GetRequest,
    GlobalLocalizationRequest,
    InitialPoseRequest,
    LocalizationRequest,
    NoMotionUpdateRequest,
    ParamsRequest,
    ReloadRequest,
    ReportRequest,
    Request,
    ResetRequest,
    SaveRequest,
    SetMapRequest,
    SetRequest,
    SnapshotRequest,
    StatusRequest,
    decode_request,
)

__all__ = ["EVENTS_AT_ONCE", "ClientConnection", "ServerContext", "answer"]

LOOKS = (StatusRequest, ParamsRequest, GetRequest, LocalizationRequest, EventsRequest)
"""Requests that change nothing."""

EVENTS_AT_ONCE = 200


async def answer(
    raw: msgspec.Raw, api: DaemonApi, origin: str, *, may_change: bool
) -> tuple[int | None, dict[str, Any] | Fault]:
    """Carry out a request; an internal error becomes an answer and an event.

    Args:
        raw: the request, one value of MessagePack.
        api: the daemon.
        origin: client, for events and settings.
        may_change: requests that change something are allowed.

    Returns:
        the request's id, where it can be read, and its result or why it was not carried out.
    """
    request, number = decode_request(raw)
    if isinstance(request, Fault):
        return number, request
    if not may_change and not isinstance(request, LOOKS):
        return number, Fault("needs_token", "requests that change something need a token over TCP")
    try:
        return number, await _carried_out(request, api, origin)
    except OperationError as error:
        return number, Fault(error.reason, str(error))
    except Exception as error:  # noqa: BLE001 an internal error must not end the daemon
        what = f"{request.__struct_config__.tag}: {type(error).__name__}: {error}"
        api.events.add(Severity.ERROR, "stream_failed", what)
        return number, Fault("failed", what)


async def _carried_out(request: Request, api: DaemonApi, origin: str) -> dict[str, Any] | Fault:
    match request:
        case ParamsRequest() | GetRequest() | SetRequest():
            return await _with_settings(request, api.settings, origin)
        case StatusRequest():
            return api.status()
        case EventsRequest(since=since):
            return _events(api.events, since)
        case ReportRequest(changes=changes, known=known, begin=begin):
            api.changes.take(changes, known, api.events, begin=begin)
            return {}
        case SaveRequest() | ResetRequest() | ReloadRequest() | SnapshotRequest():
            return await _with_session(request, api, origin)
        case _:
            return await _localized(request, api, origin)


async def _with_session(
    request: SaveRequest | ResetRequest | ReloadRequest | SnapshotRequest,
    api: DaemonApi,
    origin: str,
) -> dict[str, Any]:
    match request:
        case SaveRequest(name=name):
            return await api.save(name, origin)
        case ResetRequest():
            return await api.reset(origin)
        case ReloadRequest():
            return await api.reload(origin)
        case SnapshotRequest():
            return await api.snapshot(origin)


def _events(log: EventLog, since: int) -> dict[str, Any]:
    found, missed = log.since(min(since, log.last))
    found = found[:EVENTS_AT_ONCE]
    return {
        "events": [event.plain() for event in found],
        "missed": missed,
        "more": bool(found) and found[-1].number < log.last,
    }


async def _localized(
    request: LocalizationRequest
    | InitialPoseRequest
    | GlobalLocalizationRequest
    | NoMotionUpdateRequest
    | SetMapRequest,
    api: DaemonApi,
    origin: str,
) -> dict[str, Any]:
    match request:
        case LocalizationRequest(particles=particles):
            return api.localization(particles)
        case InitialPoseRequest(pose=pose):
            return await api.initial_pose(pose, origin)
        case GlobalLocalizationRequest():
            return await api.global_localization(origin)
        case NoMotionUpdateRequest():
            return await api.request_nomotion_update(origin)
        case SetMapRequest(name=name, pose=pose):
            return await api.set_map(name, pose, origin)


async def _with_settings(
    request: ParamsRequest | GetRequest | SetRequest, settings: ConfigStore, origin: str
) -> dict[str, Any] | Fault:
    if isinstance(request, SetRequest):
        return await _set(settings, request.changes, origin)
    for name in request.names:
        if not chosen([name]):
            return Fault("unknown_setting", f"{name[:100]!a}: there is no such setting")
    if isinstance(request, ParamsRequest):
        return facts_of(settings.current, settings.origin_of, request.names)
    config = settings.current
    return {parameter.name: value_of(config, parameter.name) for parameter in chosen(request.names)}


async def _set(
    settings: ConfigStore, changes: dict[str, Any], origin: str
) -> dict[str, Any] | Fault:
    """Apply changes in a thread: followers of settings may wait for the end of a ping."""
    result = await asyncio.to_thread(settings.apply, changes, origin)
    if isinstance(result, Refused):
        reasons = "; ".join(f"{name}: {reason}" for name, reason in result.reasons.items())
        return Fault("refused", reasons, {"reasons": dict(result.reasons)})
    return {"changed": {change.name: [change.before, change.after] for change in result.changes}}


LEAVE_S = 1.0
"""Time for the last message to arrive before the connection is aborted."""

ANSWERS_UNDER_WAY = 256 << 10
CATCH_UP_INTERVAL_S = 0.05

MAX_UNSENT = 2 * MAX_FROM_SERVER
"""Bytes in the write buffer at which a client counts as not reading: more than the largest answer
and all that the pacer allows."""

MAX_HEARD = 8192
"""Bytes to read in one turn of the event loop: some hundred of the shortest messages."""


@dataclass(frozen=True, slots=True)
class ServerContext:
    """What all connections of a server share.

    Attributes:
        operations: the daemon.
        limits: limits for clients.
        count: increments a counter.
        admit: makes a newcomer a client; raises `StreamError` if there is no room.
        heard: called after a client sent messages.
        refused: called with the reason after a newcomer was refused.
        gone: called after a connection has ended.
        clock: monotonic time, seconds.
        now_ns: Unix time that is never set back.
    """

    operations: DaemonApi
    limits: Limits
    count: Callable[[str], None]
    admit: Callable[["ClientConnection"], None]
    heard: Callable[["ClientConnection"], None]
    refused: Callable[["ClientConnection", str], None]
    gone: Callable[["ClientConnection"], None]
    clock: Callable[[], float]
    now_ns: Callable[[], int]


class ClientConnection(asyncio.BufferedProtocol):
    """A connection from the greeting to its end.

    Args:
        session: of the client.
        origin: client, for events and settings.
        context: what all connections share.

    Attributes:
        session, origin: as given.
        is_over: nothing more is sent.
        is_for_good: the client may not resume.
    """

    def __init__(self, session: ClientSession, origin: str, context: ServerContext) -> None:
        self.session = session
        self.origin = origin
        self.is_over = self.is_for_good = False
        self._context = context
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._answering: asyncio.Task[None] | None = None
        limits = context.limits
        self._asks = TokenBucket(limits.asks_per_s, limits.asks_at_once)
        self._heard = memoryview(bytearray(MAX_HEARD))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the greeting."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 of a stream
        self._transport = transport
        transport.write(self.session.greeting(self._context.clock()))
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._context.limits.hello_s, self._look_for_hello)

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 always the same
        """Return the read buffer; its size bounds the work of one turn of the event loop."""
        return self._heard

    def buffer_updated(self, nbytes: int) -> None:
        """Process received bytes."""
        if self.is_over:
            return
        was_new = self.session.state == "greeted"
        self.measure()
        try:
            self.session.take(bytes(self._heard[:nbytes]), self._context.clock())
            if was_new and self.session.state != "greeted":
                self._context.admit(self)
        except StreamError as error:
            self.refuse(error, was_new=was_new)
            return
        self._context.heard(self)
        if self.session.asks and self._answering is None:
            self._answering = asyncio.get_running_loop().create_task(self._answer())

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel what waits, and report the end of the connection."""
        if exc is not None:
            self._context.count("connections_lost")
        self.is_over = True
        for waiting in (self._timer, self._answering):
            if waiting is not None:
                waiting.cancel()
        self._context.gone(self)

    def turn(self) -> None:
        """Send what is due, unless the connection has ended while an answer was made."""
        if self.is_over:
            return
        self.measure()
        now_s = self._context.clock()
        try:
            self.session.look(now_s)
        except StreamError as error:
            self.refuse(error, was_new=False)
            return
        if self._transport and self._transport.get_write_buffer_size() > MAX_UNSENT:
            self.refuse(StreamError("the client does not read", "unread"), was_new=False)
            return
        self.write(self.session.next(now_s, self._context.now_ns()))

    def measure(self) -> None:
        """Pass the state of the connection to the pacer."""
        if self.is_over or self._transport is None:
            return
        connection = self._transport.get_extra_info("socket")
        if connection is None:
            return  # TLS that has ended; `connection_lost` follows
        state = tcp_state(connection)
        self.session.pacer.note_link(
            self._transport.get_write_buffer_size() + state.unsent,
            state.round_trip_s,
            state.trip_s,
            state.in_network,
            state.rate,
        )

    def write(self, data: bytes) -> None:
        """Send bytes; the pacer has room for them."""
        if data and not self.is_over and self._transport is not None:
            self._transport.write(data)

    def refuse(self, error: StreamError, *, was_new: bool) -> None:
        """Close the connection because of an error of the client."""
        self.is_for_good |= error.reason != "no_acks"
        kind = "refused" if was_new else "cut"
        self._context.count(f"{kind}_{error.reason}")
        if was_new:
            self._context.refused(self, error.reason)
        self.end(error.reason, str(error))

    def end(self, reason: str, message: str) -> None:
        """Send the last message and close."""
        if self.is_over or self._transport is None:
            self.abort()
            return
        self.write(self.session.bye(reason, message))
        self.is_over = True
        self._transport.close()
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(LEAVE_S, self._transport.abort)

    def abort(self) -> None:
        """Close at once, so that the client cannot resume: what it got may be incomplete."""
        self.is_for_good = True
        self.drop()

    def resume_state(self) -> ResumeState | None:
        """Return the state from which the client may resume; None if it may not."""
        return None if self.is_for_good else self.session.resume_state()

    def drop(self) -> None:
        """Close at once; the client may resume."""
        self.is_over = True
        if self._transport is not None:
            self._transport.abort()

    def _look_for_hello(self) -> None:
        if self.session.state == "greeted":
            self.refuse(StreamError("no hello arrived", "late_hello"), was_new=True)

    async def _answer(self) -> None:
        """Answer one request after the other; wait while the client does not take the answers."""
        session, context = self.session, self._context
        try:
            while session.asks and not self.is_over:
                under_way = session.pacer.in_flight
                wait_s = CATCH_UP_INTERVAL_S if under_way > ANSWERS_UNDER_WAY else 0.0
                if not wait_s:
                    wait_s = self._asks.take(context.clock())
                    context.count("requests")
                    raw = session.asks.popleft()
                    if wait_s:
                        context.count("throttled")
                        await asyncio.sleep(wait_s)
                    number, result = await answer(
                        raw, context.operations, self.origin, may_change=session.may_change
                    )
                    self._send(number, result)
                else:
                    await asyncio.sleep(wait_s)
        finally:
            self._answering = None

    def _send(self, number: int | None, result: dict[str, Any] | Fault) -> None:
        if isinstance(result, Fault):
            self._context.count("failed" if result.reason == "failed" else "asks_refused")
        self.session.answer(number, result)
        self.turn()
