"""Carry out control requests, and send events."""

import asyncio
from typing import Any

from mapperd.api import DaemonApi, OperationError
from mapperd.config.catalog import value_of
from mapperd.config.changes import chosen, facts_of
from mapperd.config.live import ConfigStore, Refused
from mapperd.events import EventLog
from mapperd.wire.control_messages import (
    Ask,
    Events,
    Fault,
    Get,
    GlobalLocalization,
    Hello,
    InitialPose,
    Localization,
    NoMotionUpdate,
    Params,
    Reload,
    Reset,
    Save,
    Set,
    SetMap,
    Snapshot,
    Status,
)

__all__ = ["EventFeed", "operate"]


async def operate(ask: Ask, operations: DaemonApi, origin: str) -> dict[str, Any] | Fault:
    """Do what is asked; hello and events are the client's own business.

    Args:
        ask: the request.
        operations: the daemon.
        origin: who asks.
    """
    try:
        match ask:
            case Params() | Get() | Set():
                return await _with_settings(ask, operations.settings, origin)
            case Status():
                return operations.status()
            case Save() | Reset() | Reload() | Snapshot() | Hello() | Events():
                return await _done(ask, operations, origin)
            case _:
                return await _localized(ask, operations, origin)
    except OperationError as error:
        return Fault(error.reason, str(error))


async def _done(ask: Ask, operations: DaemonApi, origin: str) -> dict[str, Any] | Fault:
    match ask:
        case Save(name=name):
            return await operations.save(name, origin)
        case Reset():
            return await operations.reset(origin)
        case Reload():
            return await operations.reload(origin)
        case Snapshot():
            return await operations.snapshot(origin)
        case _:
            return Fault("bad_request", "hello is said once, at the beginning")


async def _localized(
    ask: Localization | InitialPose | GlobalLocalization | NoMotionUpdate | SetMap,
    operations: DaemonApi,
    origin: str,
) -> dict[str, Any]:
    match ask:
        case Localization(particles=particles):
            return operations.localization(particles)
        case InitialPose(pose=pose):
            return await operations.initial_pose(pose, origin)
        case GlobalLocalization():
            return await operations.global_localization(origin)
        case NoMotionUpdate():
            return await operations.request_nomotion_update(origin)
        case SetMap(name=name, pose=pose):
            return await operations.set_map(name, pose, origin)


async def _with_settings(
    ask: Params | Get | Set, settings: ConfigStore, origin: str
) -> dict[str, Any] | Fault:
    if isinstance(ask, Set):
        return await _set(settings, ask.changes, origin)
    for name in ask.names:
        if not chosen([name]):
            return Fault("unknown_setting", f"{name[:100]!a}: there is no such setting")
    if isinstance(ask, Params):
        return facts_of(settings.current, settings.origin_of, ask.names)
    config = settings.current
    return {parameter.name: value_of(config, parameter.name) for parameter in chosen(ask.names)}


async def _set(
    settings: ConfigStore, changes: dict[str, Any], origin: str
) -> dict[str, Any] | Fault:
    """In a thread: whoever follows the settings may have to wait for the end of a ping."""
    result = await asyncio.to_thread(settings.apply, changes, origin)
    if isinstance(result, Refused):
        said = "; ".join(f"{name}: {reason}" for name, reason in result.reasons.items())
        return Fault("refused", said, {"reasons": dict(result.reasons)})
    return {"changed": {change.name: [change.before, change.after] for change in result.changes}}


AT_ONCE = 200


class EventFeed:
    """Where a client is in the log; nothing is kept for it.

    Args:
        log: what happened.
        since: number of the last event that the client has.
    """

    def __init__(self, log: EventLog, since: int) -> None:
        self._log = log
        self._since = min(since, log.last)

    def take(self) -> dict[str, Any]:
        """The next events, at most `AT_ONCE`.

        Returns:
            `events`; `missed`, before them, because they are not kept any more; `more` if there
            are more.
        """
        found, missed = self._log.since(self._since)
        taken = found[:AT_ONCE]
        if taken:
            self._since = taken[-1].number
        return {
            "events": [event.plain() for event in taken],
            "missed": missed,
            "more": len(found) > len(taken),
        }
