"""A recording of what a client of the map stream receives."""

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mapperd.errors import ExportError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from mapperd.client.changes import ClientChange
    from mapperd.foxglove.mcap_recorder import McapRecorder
    from mapperd.foxglove.messages import Follows

    class Records(Follows, Protocol):
        """A client of the map stream."""

        def changes(self) -> AsyncIterator[ClientChange]: ...


__all__ = ["Recording", "foxglove_missing"]


def foxglove_missing(error: ModuleNotFoundError) -> str:
    """For a person: what to install; any other module that is missing is a fault of ours.

    Raises:
        ModuleNotFoundError: it is another one.
    """
    if (error.name or "").partition(".")[0] != "foxglove":
        raise error
    return "this needs foxglove-sdk: pip install 'mapperd[foxglove]'"


TICK_S = 0.25


class Recording:
    """Writes an `.mcap` file from `start` to `stop`, in the loop of the client.

    Only what the client wants is there to be recorded: `await client.change(wants=...)` first.

    Args:
        client: running.
        path: of a file that is not there yet.
    """

    def __init__(self, client: "Records", path: Path) -> None:
        self.path = path
        self._client = client
        self._recorder: McapRecorder | None = None
        self._running: asyncio.Task[None] | None = None
        self._stopping = asyncio.Event()

    @property
    def bytes(self) -> int:
        """Written so far."""
        return self._recorder.bytes if self._recorder else 0

    @property
    def messages(self) -> int:
        """Written so far."""
        return self._recorder.messages if self._recorder else 0

    @property
    def ended(self) -> bool:
        """It ended, by `stop` or by itself; `wait` says why."""
        return self._running is not None and self._running.done()

    def start(self) -> None:
        """Make the file, and go on by itself.

        Raises:
            ExportError: it cannot be made, or the extra `foxglove` is not installed.
        """
        try:
            from mapperd.foxglove.mcap_recorder import McapRecorder  # noqa: PLC0415 an extra
        except ModuleNotFoundError as error:
            raise ExportError(foxglove_missing(error)) from error
        self._recorder = McapRecorder(self._client, self.path)
        self._running = asyncio.create_task(self._run(self._recorder))

    async def stop(self) -> None:
        """End the file.

        Raises:
            ExportError: it could not be written; the file is whole up to there.
            StreamError: the daemon would not have the client; the file is whole.
        """
        self._stopping.set()
        await self.wait()

    async def wait(self) -> None:
        """Until it ends, as `stop` does; to stop waiting does not stop it."""
        if self._running is not None:
            await asyncio.shield(self._running)

    async def _run(self, recorder: "McapRecorder") -> None:
        parts = [
            asyncio.create_task(self._follow(recorder)),
            asyncio.create_task(_tick(recorder)),
            asyncio.create_task(self._stopped()),
        ]
        try:
            await asyncio.wait(parts, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for part in parts:
                part.cancel()
            ended = await asyncio.gather(*parts, return_exceptions=True)
            errors = [end for end in ended if isinstance(end, Exception)]
            if any(isinstance(error, ExportError) for error in errors):
                recorder.abandon()
            else:
                recorder.end(time.monotonic())
        for error in errors:
            raise error

    async def _follow(self, recorder: "McapRecorder") -> None:
        async for change in self._client.changes():
            recorder.take(change, time.monotonic())

    async def _stopped(self) -> None:
        await self._stopping.wait()


async def _tick(recorder: "McapRecorder") -> None:
    while True:
        recorder.tick(time.monotonic())
        await asyncio.sleep(TICK_S)
