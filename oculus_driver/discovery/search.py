"""Which of the sonars that are heard is ours."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol, cast

if TYPE_CHECKING:
    from oculus_driver.status import Status

_LOG: Final = logging.getLogger(__name__)


class Sighting(Protocol):
    """A sonar that was heard."""

    @property
    def address(self) -> str:
        """Where to connect."""
        ...

    @property
    def status(self) -> Status:
        """Its last status."""
        ...


class Sightings(Protocol):
    """Whatever hears sonars."""

    def sightings(self) -> AsyncIterator[Sighting]:
        """Return what is heard, as it is heard."""
        ...


MakeDiscovery = Callable[[], AbstractAsyncContextManager[Sightings]]


class Search:
    """Listens for one sonar, as a task.

    Args:
        serial: its device id, None for the first that is heard.
        discovery: makes what hears sonars, None for `oculus_driver.discovery.listener.Discovery`.

    Attributes:
        status: its last status, None before the first.
    """

    def __init__(self, serial: int | None, discovery: MakeDiscovery | None) -> None:
        self.status: Status | None = None
        self._serial = serial
        self._discovery = discovery or _default_discovery
        self._others: set[int] = set()
        self._task: asyncio.Task[None] | None = None

    def start(
        self, on_sighted: Callable[[Sighting], None], on_failure: Callable[[BaseException], None]
    ) -> None:
        """Begin; what goes wrong is given to `on_failure`."""
        self._task = asyncio.create_task(self._listen(on_sighted, on_failure))

    async def stop(self) -> None:
        """End the task and wait for it."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait((self._task,))

    async def _listen(
        self, on_sighted: Callable[[Sighting], None], on_failure: Callable[[BaseException], None]
    ) -> None:
        try:
            async with self._discovery() as discovery:
                async for sighting in discovery.sightings():
                    if self._is_ours(sighting):
                        on_sighted(sighting)
        except Exception as error:  # noqa: BLE001 - handed to whoever waits for pings
            on_failure(error)

    def _is_ours(self, sighting: Sighting) -> bool:
        serial = sighting.status.device_id
        if self._serial is None:
            self._serial = serial
        if serial == self._serial:
            self.status = sighting.status
            return True
        if serial not in self._others and len(self._others) < _OTHERS_NAMED:
            self._others.add(serial)
            words = "sonar %d at %s is not ours, which is %d: give a serial to choose"
            _LOG.warning(words, serial, sighting.address, self._serial)
        return False


_OTHERS_NAMED: Final = 16


def _default_discovery() -> AbstractAsyncContextManager[Sightings]:
    made = import_module("oculus_driver.discovery.listener").Discovery()
    return cast("AbstractAsyncContextManager[Sightings]", made)
