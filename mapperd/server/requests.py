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
    Events,
    Fault,
    Get,
    GlobalLocalization,
    InitialPose,
    Localization,
    NoMotionUpdate,
    Params,
    Reload,
    Request,
    Reset,
    Save,
    Set,
    SetMap,
    Snapshot,
    Status,
    decode_request,
)

__all__ = ["EVENTS_AT_ONCE", "answer"]

LOOKS = (Status, Params, Get, Localization, Events)
"""Requests that change nothing."""

EVENTS_AT_ONCE = 200


async def answer(
    raw: msgspec.Raw, api: DaemonApi, origin: str, *, may_change: bool
) -> tuple[int | None, dict[str, Any] | Fault]:
    """Carry out a request; an error of ours becomes an answer and an event.

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
        return number, Fault("needs_token", "changing anything by TCP needs a token")
    try:
        return number, await _carried_out(request, api, origin)
    except OperationError as error:
        return number, Fault(error.reason, str(error))
    except Exception as error:  # noqa: BLE001 a fault of ours must not end the daemon
        what = f"{type(request).__name__.lower()}: {type(error).__name__}: {error}"
        api.events.add(Severity.ERROR, "stream_failed", what)
        return number, Fault("failed", what)


async def _carried_out(request: Request, api: DaemonApi, origin: str) -> dict[str, Any] | Fault:
    match request:
        case Params() | Get() | Set():
            return await _with_settings(request, api.settings, origin)
        case Status():
            return api.status()
        case Events(since=since):
            return _events(api.events, since)
        case Save() | Reset() | Reload() | Snapshot():
            return await _with_session(request, api, origin)
        case _:
            return await _localized(request, api, origin)


async def _with_session(
    request: Save | Reset | Reload | Snapshot, api: DaemonApi, origin: str
) -> dict[str, Any]:
    match request:
        case Save(name=name):
            return await api.save(name, origin)
        case Reset():
            return await api.reset(origin)
        case Reload():
            return await api.reload(origin)
        case Snapshot():
            return await api.snapshot(origin)


def _events(log: EventLog, since: int) -> dict[str, Any]:
    found, missed = log.since(min(since, log.last))
    return {
        "events": [event.plain() for event in found[:EVENTS_AT_ONCE]],
        "missed": missed,
        "more": len(found) > EVENTS_AT_ONCE,
    }


async def _localized(
    request: Localization | InitialPose | GlobalLocalization | NoMotionUpdate | SetMap,
    api: DaemonApi,
    origin: str,
) -> dict[str, Any]:
    match request:
        case Localization(particles=particles):
            return api.localization(particles)
        case InitialPose(pose=pose):
            return await api.initial_pose(pose, origin)
        case GlobalLocalization():
            return await api.global_localization(origin)
        case NoMotionUpdate():
            return await api.request_nomotion_update(origin)
        case SetMap(name=name, pose=pose):
            return await api.set_map(name, pose, origin)


async def _with_settings(
    request: Params | Get | Set, settings: ConfigStore, origin: str
) -> dict[str, Any] | Fault:
    if isinstance(request, Set):
        return await _set(settings, request.changes, origin)
    for name in request.names:
        if not chosen([name]):
            return Fault("unknown_setting", f"{name[:100]!a}: there is no such setting")
    if isinstance(request, Params):
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
