"""Carry out control requests."""

import asyncio
from typing import Any

import msgspec

from mapperd.api import DaemonApi, OperationError
from mapperd.config.catalog import value_of
from mapperd.config.changes import chosen, facts_of
from mapperd.config.live import ConfigStore, Refused
from mapperd.events import EventLog, Severity
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
    Request,
    ResetRequest,
    SaveRequest,
    SetMapRequest,
    SetRequest,
    SnapshotRequest,
    StatusRequest,
    decode_request,
)

__all__ = ["EVENTS_AT_ONCE", "answer"]

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
