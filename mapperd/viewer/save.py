"""Buttons of the page that save files: a recording of the stream, the map."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from mapperd.errors import MapperdError
from mapperd.export.formats import FORMATS, write_map

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle, ViserServer

    from mapperd.client import MapClient

__all__ = ["MapRecorder", "SaveControls"]

NOTE_S = 8.0
RECORD = "\N{BLACK CIRCLE} Record"
MAX_DOWNLOAD = 64 << 20
"""Larger files are not sent to the browser."""


class MapRecorder(Protocol):
    """A recording in the background, from `start` to `stop`."""

    @property
    def path(self) -> Path: ...  # noqa: D102

    @property
    def bytes(self) -> int: ...  # noqa: D102

    @property
    def ended(self) -> bool: ...  # noqa: D102

    def start(self) -> None: ...  # noqa: D102

    async def stop(self) -> None: ...  # noqa: D102


class SaveControls:
    """Record and export; use from the drawing thread.

    Args:
        server: server of the page.
        tab: parent of the buttons.
        client: client of the map stream.
        folder: folder for files, on the computer that serves the page.
        recorder: makes a recording of a client; None hides the button.
        begin: runs a coroutine in the drawing thread; callable from any thread.
    """

    def __init__(
        self,
        server: "ViserServer",
        tab: "GuiTabHandle",
        client: "MapClient",
        *,
        folder: Path,
        recorder: Callable[["MapClient", Path], MapRecorder] | None,
        begin: Callable[[Callable[[], Coroutine[Any, Any, None]]], None],
    ) -> None:
        self._server = server
        self._client = client
        self._folder = folder
        self._make = recorder
        self._running: MapRecorder | None = None
        with tab, server.gui.add_folder("Save"):
            if recorder is not None:
                self._button = server.gui.add_button(RECORD, color="red")
                self._button.on_click(lambda event: begin(lambda: self._record(event.client)))
            self._format = server.gui.add_dropdown("Format", tuple(FORMATS), initial_value=".ply")
            export = server.gui.add_button("Export map")
            export.on_click(lambda event: begin(lambda: self._export(event.client)))

    async def update(self) -> None:
        """Show the size of the recording; notify all browsers if it ended by itself."""
        if self._running is None:
            return
        if self._running.ended:
            await self.stop()
        else:
            self._button.label = f"Stop recording ({self._running.bytes / 1e6:.1f} MB)"

    async def stop(self, who: "ClientHandle | None" = None) -> None:
        """Stop the recording, if any, and show the result."""
        running, self._running = self._running, None
        if running is None:
            return
        self._button.label = RECORD
        try:
            await running.stop()
        except MapperdError as error:
            self._note(who, "Recording ended", f"{running.path}: {error}", "red")
        else:
            self._note(who, "Recorded", f"{running.path}: {running.bytes / 1e6:.1f} MB", "green")

    async def _record(self, who: "ClientHandle | None") -> None:
        if self._running is not None:
            await self.stop(who)
            return
        assert self._make is not None  # noqa: S101 otherwise there is no button
        begun = self._make(self._client, self._folder / _named("dive", ".mcap"))
        try:
            begun.start()
        except MapperdError as error:
            self._note(who, "Not recorded", str(error), "red")
            return
        self._running = begun
        self._note(who, "Recording", f"into {begun.path}", "red")

    async def _export(self, who: "ClientHandle | None") -> None:
        mirror = self._client.mirror
        if mirror is None:
            self._note(who, "Not exported", "there is no map yet", "red")
            return
        path = self._folder / _named("map", self._format.value)
        try:
            files = await asyncio.to_thread(lambda: write_map(mirror.to_map(), path))
        except MapperdError as error:
            self._note(who, "Not exported", str(error), "red")
            return
        for file in files:
            data = await asyncio.to_thread(file.read_bytes)
            if who is not None and len(data) <= MAX_DOWNLOAD:
                who.send_file_download(file.name, data, save_immediately=True)
        self._note(who, "Exported", ", ".join(map(str, files)), "green")

    def _note(self, who: "ClientHandle | None", title: str, text: str, colour: Any) -> None:  # noqa: ANN401
        for one in [who] if who else self._server.get_clients().values():
            one.add_notification(title, text, auto_close_seconds=NOTE_S, color=colour)


def _named(what: str, suffix: str) -> str:
    return time.strftime(f"{what}-%Y%m%d-%H%M%S{suffix}")
