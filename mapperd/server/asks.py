"""Requests of docs/control.md that come by the map stream."""

from typing import Any

import msgspec

from mapperd.api import Operations
from mapperd.events import Severity
from mapperd.server.dispatch import operate
from mapperd.server.feed import EventFeed
from mapperd.wire.control_messages import (
    Ask,
    Events,
    Fault,
    Get,
    Localization,
    Params,
    Status,
    decode_ask,
)

__all__ = ["answered"]

LOOKS = (Status, Params, Get, Localization, Events)
"""Requests that change nothing."""


async def answered(
    raw: msgspec.Raw, operations: Operations, origin: str, *, may_change: bool
) -> tuple[int | None, dict[str, Any] | Fault]:
    """Do what is asked; whatever goes wrong, the client is told and the daemon goes on.

    Args:
        raw: the request, one value of MessagePack.
        operations: the daemon.
        origin: who asks.
        may_change: more than looking is allowed.

    Returns:
        The number of the request, where it can be read, and what became of it.
    """
    ask, number = _decoded(raw)
    if isinstance(ask, Fault):
        return number, ask
    if not may_change and not isinstance(ask, LOOKS):
        return number, Fault("needs_token", "changing anything by TCP needs stream.token_file")
    try:
        return number, await _done(ask, operations, origin)
    except Exception as error:  # noqa: BLE001 a fault of ours must not end the daemon
        what = f"{type(ask).__name__.lower()}: {type(error).__name__}: {error}"
        operations.events.add(Severity.ERROR, "stream_failed", what)
        return number, Fault("failed", what)


async def _done(ask: Ask, operations: Operations, origin: str) -> dict[str, Any] | Fault:
    if not isinstance(ask, Events):
        return await operate(ask, operations, origin)
    if ask.follow:
        return Fault("bad_request", "events are followed by wanting them")
    return EventFeed(operations.events, ask.since).take()


def _decoded(raw: msgspec.Raw) -> tuple[Ask | Fault, int | None]:
    """As JSON, which the requests are written in: what it cannot say is in none of them."""
    try:
        line = msgspec.json.encode(msgspec.msgpack.decode(raw))
    except (msgspec.MsgspecError, TypeError, ValueError, OverflowError, RecursionError) as error:
        return Fault("bad_request", f"no request: {error}"), None
    return decode_ask(line)
