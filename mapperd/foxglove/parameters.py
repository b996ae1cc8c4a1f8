"""The daemon's live settings as parameters of viewers, both ways."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from foxglove.websocket import ChannelView, Client, Parameter, ServerListener

from mapperd.client.errors import AskError

__all__ = ["LiveParameters", "Steers"]

ANSWER_S = 10.0
"""A viewer that set something waits as long."""


class Steers(Protocol):
    """A client of the map stream, as far as settings go."""

    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102
    async def set(self, changes: Mapping[str, Any]) -> Mapping[str, Any]: ...  # noqa: D102


class LiveParameters(ServerListener):
    """Answers viewers, in threads of the server.

    Args:
        client: that knows and sets.
        loop: of the client.
        warn: of what is refused; called in the loop.
        watched: a viewer began to watch a topic; called in the loop.
        may_change: viewers may set.
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
        """Take what the daemon said of settings; returns the live ones among them."""
        live = {
            name: fact["value"]
            for name, fact in facts.items()
            if fact.get("dynamic") and fact.get("value") is not None
        }
        self._values = {**self._values, **live}
        return _parameters(live)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        """Somebody watches a channel now."""
        self._loop.call_soon_threadsafe(self._watched, channel.topic)

    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Those of these names; without names, all."""
        return self._now(param_names)

    def on_set_parameters(
        self,
        client: Client,  # noqa: ARG002
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Set them, all or none; the answer has the values that are in force afterwards."""
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
            self._warn(f"{_names(changes)}: viewers may not change settings here: --allow-changes")
            return
        strange = changes.keys() - self._values.keys()
        if strange:
            self._warn(f"{_names(strange)}: no live setting of the daemon")
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
    """JSON knows one kind of numbers: a whole one is meant where one was."""
    whole = isinstance(before, int) and not isinstance(before, bool)
    if whole and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _names(names: Any) -> str:  # noqa: ANN401 any collection of them
    return ", ".join(sorted(names))
