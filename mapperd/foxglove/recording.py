"""Records what a client of the map stream receives."""

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mapperd.errors import ExportError, ExportExtraError, missing_extra

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from mapperd.client.changes import ClientChange
    from mapperd.foxglove.mcap_recorder import McapRecorder
    from mapperd.foxglove.messages import Follows

    class Records(Follows, Protocol):
        """A client of the map stream."""

        def changes(self) -> AsyncIterator[ClientChange]: ...


__all__ = ["FoxgloveRecording", "foxglove_missing"]


def foxglove_missing(error: ModuleNotFoundError) -> str:
    """Describe how to install the missing extra.

    Raises:
        ModuleNotFoundError: another module is missing.
    """
    if (error.name or "").partition(".")[0] != "foxglove":
        raise error
    return missing_extra("foxglove-sdk", "foxglove")


TICK_S = 0.25


class FoxgloveRecording:
    """Writes an `.mcap` file from `start` to `stop`, in the loop of the client.

    It records only what the client requested: call `await client.change(wants=...)` first.

    Args:
        client: running client.
        path: a new file.
    """

    def __init__(self, client: "Records", path: Path) -> None:
        self.path = path
        self._client = client
        self._recorder: McapRecorder | None = None
        self._running: asyncio.Task[None] | None = None
        self._stopping = asyncio.Event()

    @property
    def bytes(self) -> int:
        """Number written so far."""
        return self._recorder.bytes if self._recorder else 0

    @property
    def messages(self) -> int:
        """Number written so far."""
        return self._recorder.messages if self._recorder else 0

    @property
    def ended(self) -> bool:
        """Whether it ended, by `stop` or by itself; `wait` raises the reason."""
        return self._running is not None and self._running.done()

    def start(self) -> None:
        """Create the file and record in the background.

        Raises:
            ExportError: the file cannot be created.
            ExportExtraError: the extra `foxglove` is not installed.
        """
        try:
            from mapperd.foxglove.mcap_recorder import McapRecorder  # noqa: PLC0415 an extra
        except ModuleNotFoundError as error:
            raise ExportExtraError(foxglove_missing(error)) from error
        self._recorder = McapRecorder(self._client, self.path)
        self._running = asyncio.create_task(self._run(self._recorder))

    async def stop(self) -> None:
        """Finish the file.

        Raises:
            ExportError: writing failed; the file is valid up to that point.
            StreamError: the daemon refused the client; the file is valid.
        """
        self._stopping.set()
        await self.wait()

    async def wait(self) -> None:
        """Wait for the end; raises as `stop`. Cancelling the wait does not stop the recording."""
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
