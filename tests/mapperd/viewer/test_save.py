"""The record button reports the end of a recording, whatever ends it."""

import argparse
import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, ClassVar, cast

import pytest
from mcap.reader import make_reader

from mapperd.cli.mapperctl import view
from mapperd.errors import ExportError
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.viewer.tools import SaveControls
from tests.mapperd.foxglove import foxglove_fakes as fakes
from tests.support.waiting import until

pytest.importorskip("viser", reason="the extra `topside` is not installed")

from mapperd.cli.mapperctl.view import open_page


class Notes:
    """Collects the notifications of one browser."""

    def __init__(self) -> None:
        self.notes: list[tuple[str, str]] = []

    def add_notification(self, title: str, text: str, **_: Any) -> None:
        self.notes.append((title, text))


class Watched:
    """A page's server that one browser watches."""

    def __init__(self, gui: Any) -> None:
        self.gui = gui
        self.notes = Notes()

    def get_clients(self) -> dict[int, Notes]:
        return {0: self.notes}


def kept(folder: Path, press: Callable[[SaveControls, Notes, Any], Awaitable[None]]) -> Notes:
    """Return the notifications of a browser whose buttons are pressed."""
    server = open_page("127.0.0.1", 0)
    watched = Watched(server.gui)

    async def run() -> None:
        client = fakes.FakeStream()
        keep = SaveControls(
            cast("Any", watched),
            server.gui.add_tab_group().add_tab("View"),
            cast("Any", client),
            folder=folder,
            recorder=cast("Any", FoxgloveRecording),
            begin=lambda _: None,
        )
        await press(keep, watched.notes, client)
        await keep.stop()

    try:
        asyncio.run(run())
    finally:
        server.stop()
    return watched.notes


def test_two_presses_make_a_recording(tmp_path: Path) -> None:
    async def press(keep: SaveControls, notes: Notes, client: Any) -> None:
        await keep._record(cast("Any", notes))
        await asyncio.sleep(0)
        client.feed_all()
        await until(lambda: not client.unread)
        await keep.update()
        assert keep._button.label.startswith("Stop recording (")
        await keep._record(cast("Any", notes))
        assert "Record" in keep._button.label

    notes = kept(tmp_path, press)
    (path,) = tmp_path.iterdir()
    assert [title for title, _ in notes.notes] == ["Recording", "Recorded"]
    assert str(path) in notes.notes[1][1]
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count > 0


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [one for one in sys.modules if one.partition(".")[0] == "foxglove"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "mapperd.foxglove.mcap_recorder", raising=False)
    monkeypatch.setitem(sys.modules, "foxglove", None)

    async def press(keep: SaveControls, notes: Notes, _: Any) -> None:
        await keep._record(cast("Any", notes))

    ((title, text),) = kept(tmp_path, press).notes
    assert title == "Not recorded"
    assert "pip install 'foxglove-sdk" in text
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_ends_by_itself_is_reported(tmp_path: Path) -> None:
    async def press(keep: SaveControls, notes: Notes, _: Any) -> None:
        await keep._record(cast("Any", notes))
        running = cast("Any", keep._running)
        running._recorder.tick = full
        await until(lambda: running.ended)
        await keep.update()
        assert keep._running is None
        assert "Stop" not in keep._button.label

    def full(_: float) -> None:
        raise ExportError("no space is left")

    notes = kept(tmp_path, press).notes
    assert [title for title, _ in notes] == ["Recording", "Recording ended"]
    assert "no space is left" in notes[1][1]


class NoView:
    """Instead of the page's view."""

    made: ClassVar[list[Any]] = []

    def __init__(self, *_: Any, recorder: Any, **__: Any) -> None:
        self.made.append(recorder)

    async def run(self) -> None:
        return


def test_the_command_s_page_can_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "ViewerPage", NoView)
    message = argparse.Namespace(
        host="127.0.0.1", port=0, open=False, json=True, level=0, radius=0.0, allow_changes=False
    )
    list(view.run_view(message, str(tmp_path / "none.sock"), None, None))
    assert NoView.made == [FoxgloveRecording]
