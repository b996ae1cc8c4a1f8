"""Every recorded session is in the map, or is mapped at the next start, or is named."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.config.tree import Config
from mapperd.errors import CheckpointError
from mapperd.events import Event, EventLog
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session import recovery
from mapperd.session.replay import as_recorded
from mapperd.session.startup import open_map
from mapperd.session_log import Reset
from mapperd.store.reader import StoreReader
from oculus_driver.recording import OCULUS, RecordingWriter, open_recording
from tests.mapperd.session.crash import test_startup as sessions
from tests.mapperd.store import dive


def start(config: Config) -> tuple[dict[str, Event], dict[str, Any]]:
    """Start once; return the events by code, and the status of the map file."""
    events = EventLog(lambda: 0)
    opened = open_map(config, "new", events, {}, lambda: 1.0)
    status = opened.persistence.status()
    opened.close()
    assert status is not None
    return {event.code: event for event in events.since(0)[0]}, status


def map_path(config: Config) -> Path:
    return Path(config.outofcore.map_path)


def test_a_session_that_the_map_file_forgot_is_mapped(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    for number, session in enumerate("abc", 1):
        sessions.record(config, number, session, range(10 * number, 10 * number + 8))
    sessions.mapped(config, "a")
    events, _ = start(config)
    assert events["sessions_mapped"].facts == {"sessions": ["b", "c"], "pings": 16}
    found, position = sessions.content(config)
    assert found == sessions.reference(config, "a", "b", "c")
    assert position.sessions == ("a", "b", "c")
    assert set(start(config)[0]) == {"map_continued"}


@pytest.mark.parametrize("left", ["nothing", "no bytes"])
def test_a_missing_map_file_beside_recordings_is_mapped_again(tmp_path: Path, left: str) -> None:
    config = sessions.config_of(tmp_path)
    sessions.record(config, 1, "a", range(8))
    if left == "no bytes":
        map_path(config).touch()
    events, _ = start(config)
    assert "holds no session" in events["sessions_mapped"].text
    assert sessions.content(config)[0] == sessions.reference(config, "a")


def test_an_interruption_while_sessions_are_mapped_loses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = sessions.config_of(tmp_path)
    for number, session in enumerate("ab", 1):
        sessions.record(config, number, session, range(10 * number, 10 * number + 8))

    def killed(stored: recovery.StoredSession, *rest: Any, **more: Any) -> Any:
        for count, _ in enumerate(map_rest(stored, *rest, **more)):
            if count == 10:
                stored.store.save()
            if count == 12:
                raise KeyboardInterrupt
            yield

    map_rest = recovery.map_rest
    with monkeypatch.context() as patch:
        patch.setattr(recovery, "map_rest", killed)
        with pytest.raises(KeyboardInterrupt):
            start(config)
    assert set(start(config)[0]) >= {"recovered", "sessions_mapped"}
    assert sessions.content(config)[0] == sessions.reference(config, "a", "b")


def test_a_session_that_cannot_be_mapped_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = sessions.config_of(tmp_path)
    sessions.record(config, 1, "a", range(8))
    sessions.mapped(config, "a")
    path = sessions.record(config, 2, "b", range(8))
    sessions.record(config, 3, "c", range(8))

    def without_map(recorded: Any) -> Any:
        if recorded.session == "c":
            raise CheckpointError("its known map is gone")
        return as_recorded(recorded)

    monkeypatch.setattr(recovery, "as_recorded", without_map)
    headless(path)
    events, status = start(config)
    named = {"b": "its first file is missing", "c": "its known map is gone"}
    assert events["sessions_not_mapped"].facts["sessions"] == named
    assert status["sessions_not_mapped"] == named
    assert "b: its first file is missing" in events["sessions_not_mapped"].text
    assert start(config)[1]["sessions_not_mapped"] == named


def headless(path: Path) -> None:
    """Make the recording one without its beginning: a later file of the session."""
    with open_recording(path) as recording:
        metadata, chunks = recording.metadata, list(recording)
    path.unlink()
    with RecordingWriter(path, metadata=metadata) as writer:
        link = writer.add_link("sonar", OCULUS)
        for chunk in chunks:
            if chunk.encoding == OCULUS:
                writer.write(link, chunk.data, chunk.arrival_ns)


def test_sessions_before_the_map_are_named_and_those_before_a_reset_are_not(
    tmp_path: Path,
) -> None:
    config = sessions.config_of(tmp_path)
    sessions.record(config, 1, "a", range(8))
    sessions.record(config, 2, "b", range(8, 16))
    sessions.mapped(config, "b")
    events, status = start(config)
    assert list(status["sessions_not_mapped"]) == ["a"]
    assert "recorded before" in events["sessions_not_mapped"].text
    sessions.record(config, 3, "c", range(16, 30), at=20, what=Reset(1, "test"))
    sessions.mapped(config, "c")
    events, status = start(config)
    assert sessions.content(config)[1].sessions == ("c",)
    assert list(status["sessions_not_mapped"]) == ["a"]  # b was emptied from the map on request
    assert sessions.content(config)[0] == sessions.reference(config, "c")


def test_a_map_that_does_not_record_its_sessions_is_left_as_it_is(tmp_path: Path) -> None:
    config = msgspec.structs.replace(sessions.config_of(tmp_path), octree=dive.CONFIG.octree)
    sessions.record(config, 1, "a", range(8))
    sonar_map, store = dive.open_store(map_path(config))
    with store:
        dive.dive_on(sonar_map, store, 0, 10)
    events, status = start(config)
    assert list(events) == ["sessions_not_mapped"]
    assert status["sessions_not_mapped"] == {"a": "the map file does not list its sessions"}
    whole = SonarMap(config)
    with StoreReader(map_path(config)) as reader:
        reader.load(whole)
    assert whole.sha256() == dive.mapped(10).sha256()


@pytest.mark.parametrize("readable", [True, False])
@pytest.mark.parametrize("left", ["ab", "a", ""])
def test_what_a_damaged_file_alone_held_is_named(
    tmp_path: Path, left: str, *, readable: bool
) -> None:
    config = sessions.config_of(tmp_path)
    paths = {
        session: sessions.record(config, number, session, range(10 * number, 10 * number + 8))
        for number, session in enumerate("ab", 1)
    }
    for session in "ab":
        sessions.mapped(config, session)
    for session in set("ab") - set(left):
        paths[session].unlink()
    path = map_path(config)
    if readable:
        with closing(sqlite3.connect(path)) as file, file:
            file.execute("UPDATE progress SET revision = 1")  # against its checksum
    else:
        path.write_bytes(path.read_bytes()[:100] + bytes(path.stat().st_size - 100))
    events, status = start(config)
    assert "store_damaged" in events
    if readable:
        assert set(status["sessions_not_mapped"]) == set("ab") - set(left)
        assert status["data_lost"] == (left != "ab")
    else:
        assert status["data_lost"] == (not left)
        assert list(status["sessions_not_mapped"]) == (["dive.map.damaged-1"] if not left else [])
