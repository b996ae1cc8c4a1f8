"""A session whose map has no space on its disk does not start."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mapperd.config.loader import config_from_text
from mapperd.daemon import run
from mapperd.errors import StoreError
from mapperd.events import EventLog


def require(folder: Path, free: int, monkeypatch: pytest.MonkeyPatch, more: str = "") -> EventLog:
    monkeypatch.setattr(run, "free_bytes_of", lambda place: free if place == folder else 1 << 40)
    live: Any = SimpleNamespace(recorder=SimpleNamespace(shortage=lambda: None))
    store = SimpleNamespace(path=folder / "dive.map")
    opened: Any = SimpleNamespace(persistence=SimpleNamespace(store=store))
    events = EventLog(lambda: 0)
    run._require_space(config_from_text(more), live, opened, events)
    return events


def test_a_full_disk_of_the_map_refuses_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert require(tmp_path, run.MIN_FREE_BYTES, monkeypatch).last == 0
    with pytest.raises(StoreError, match="free for the map") as refused:
        require(tmp_path, run.MIN_FREE_BYTES - 1, monkeypatch)
    assert refused.value.reason == "disk_full"


def test_it_is_logged_where_the_settings_allow_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = "recording: {require_space: false}"
    events = require(tmp_path, run.MIN_FREE_BYTES - 1, monkeypatch, more)
    assert [event.code for event in events.since(0)[0]] == ["no_space"]
