"""Requests to localization on their way to the mapping thread, and the answers back."""

import asyncio
import contextlib
from itertools import count

from msgspec.structs import replace

from mapperd.localization.session import KnownMaps
from mapperd.pipeline.ingest import Inlet
from mapperd.reject import Reject
from mapperd.session_log import NewMap, Request, SetMap

__all__ = ["CLOSED", "Requests"]

CLOSED = Reject("closed", "mapping has ended")


class Requests:
    """Of one session; of one event loop, but for `done`.

    Args:
        inlet: takes them as orders, which are recorded.
        maps: loads the maps that they name; None where localization is off.
    """

    def __init__(self, inlet: Inlet, maps: KnownMaps | None) -> None:
        self._inlet = inlet
        self._maps = maps
        self._numbers = count(1)
        self._waiting: dict[int, asyncio.Future[Reject | None]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """Begin; from the event loop."""
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """Nothing more is answered: whoever waits is told."""
        self._loop = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_result(CLOSED)

    async def ask(self, request: Request) -> Reject | None:
        """As `Live.ask`."""
        if self._loop is None:
            return CLOSED
        request = replace(request, number=next(self._numbers))
        if isinstance(request, NewMap | SetMap) and self._maps is not None:
            known = await asyncio.to_thread(self._maps.load, request.path)
            request = replace(request, path=known.path, sha256=known.sha256)
            if self._loop is None:  # it has ended meanwhile
                return CLOSED
            self._maps.offer(known)
        answer: asyncio.Future[Reject | None] = asyncio.get_running_loop().create_future()
        self._waiting[request.number] = answer
        try:
            self._inlet.order(request)
            return await answer
        finally:
            self._waiting.pop(request.number)

    def done(self, request: Request, refused: Reject | None) -> None:
        """A request was carried out, or refused; any thread."""
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # nobody is left to be told
                loop.call_soon_threadsafe(self._answer, request.number, refused)

    def _answer(self, number: int, refused: Reject | None) -> None:
        answer = self._waiting.get(number)
        if answer is not None and not answer.done():
            answer.set_result(refused)
