"""The daemon's live settings as Foxglove parameters, both ways."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from foxglove.websocket import ChannelView, Client, Parameter, ServerListener

from mapperd.client.errors import AskError

__all__ = ["LiveParameters", "Steers"]

ANSWER_S = 10.0
"""Timeout of a viewer's request to set parameters."""


class Steers(Protocol):
    """The settings side of a map stream client."""

    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102
    async def set(self, changes: Mapping[str, Any]) -> Mapping[str, Any]: ...  # noqa: D102


class LiveParameters(ServerListener):
    """Answers viewers in the server's threads.

    Args:
        client: client of the map stream.
        loop: event loop of the client.
        warn: called in the loop with the reason of a refusal.
        watched: called in the loop with a topic that got a subscriber.
        may_change: viewers may set parameters.
    """

    def __init__(
        self,
        client: Steers,
        loop: asyncio.AbstractEventLoop,
        warn: Callable[[str], None],
        watched: Callable[[str], None],
        *,
        may_change: bool,
    ) -> None:
        self._client = client
        self._loop = loop
        self._warn = warn
        self._watched = watched
        self._may_change = may_change
        self._values: dict[str, Any] = {}

    def note(self, facts: Mapping[str, Any]) -> list[Parameter]:
        """Update the values from the daemon; return the live settings among them."""
        live = {
            name: fact["value"]
            for name, fact in facts.items()
            if fact.get("dynamic") and fact.get("value") is not None
        }
        self._values = {**self._values, **live}
        return _parameters(live)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        """Report a new subscriber."""
        self._loop.call_soon_threadsafe(self._watched, channel.topic)

    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Return the parameters of these names, or all."""
        return self._now(param_names)

    def on_set_parameters(
        self,
        client: Client,  # noqa: ARG002
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Set all or none; return the values in force afterwards."""
        changes = {one.name: one.get_value() for one in parameters}
        done = asyncio.run_coroutine_threadsafe(self._set(changes), self._loop)
        try:
            done.result(ANSWER_S)
        except TimeoutError:
            done.cancel()
            self._loop.call_soon_threadsafe(self._warn, f"{_names(changes)}: no answer")
        return self._now(list(changes))

    async def _set(self, changes: dict[str, Any]) -> None:
        """In the client's loop."""
        if not self._may_change:
            self._warn(
                f"{_names(changes)}: viewers may not change settings; start with --allow-changes"
            )
            return
        unknown = changes.keys() - self._values.keys()
        if unknown:
            self._warn(f"{_names(unknown)}: not a live setting of the daemon")
            return
        try:
            changed = await self._client.set(
                {name: _like(self._values[name], value) for name, value in changes.items()}
            )
        except AskError as error:
            text = str(error)
            named = any(name in text for name in changes)
            self._warn(text if named else f"{_names(changes)}: {text}")
            return
        self._values = {**self._values, **{name: after for name, (_, after) in changed.items()}}

    def _now(self, names: list[str]) -> list[Parameter]:
        values = self._values
        return _parameters(
            {name: values[name] for name in names or sorted(values) if name in values}
        )


def _parameters(values: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def _like(before: object, value: Any) -> Any:  # noqa: ANN401 plain values
    """Convert a whole float to int where the setting is an int: JSON has one kind of number."""
    whole = isinstance(before, int) and not isinstance(before, bool)
    if whole and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _names(names: Any) -> str:  # noqa: ANN401 any collection of them
    return ", ".join(sorted(names))
