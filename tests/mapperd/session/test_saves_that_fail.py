"""Saves fail while recordings are mapped: the start is refused, and the next one maps the rest."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.session.replay_to_store import map_into_store
from mapperd.session.store_session import SqlitePersistence
from mapperd.store.position import Position, RecordingOffset
from mapperd.store.transfer import Saver, Snapshot
from tests.mapperd.session.crash import test_startup as sessions
from tests.mapperd.session.test_store_session import Session

PINGS = 30


def interrupted(config: Config) -> None:
    sessions.record(config, 1, "a", range(PINGS))
    sessions.mapped(config, "a", chunks=60, save_at=20)


def forgotten(config: Config) -> None:
    for number, session in enumerate("ab", 1):
        sessions.record(config, number, session, range(10 * number, 10 * number + 10))
    sessions.mapped(config, "a")


def damaged(config: Config) -> None:
    sessions.record(config, 1, "a", range(PINGS))
    sessions.mapped(config, "a")
    path = Path(config.outofcore.map_path)
    data = path.read_bytes()
    path.write_bytes(data[:100] + bytes(3900) + data[4000:])


def full(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every save with bricks fail; those of the beginning of a session have none."""
    write = Saver.write

    def refuse(saver: Saver, snapshot: Snapshot) -> None:
        if list(snapshot.bricks):
            raise StoreError("the disk is full", "disk_full")
        write(saver, snapshot)

    monkeypatch.setattr(Saver, "write", refuse)


@pytest.mark.parametrize(
    ("prepare", "names", "done"),
    [
        (interrupted, "a", "recovered"),
        (forgotten, "ab", "recovered"),
        (damaged, "a", "map_rebuilt"),
    ],
)
def test_recordings_are_mapped_once_there_is_space(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    prepare: Callable[[Config], None],
    names: str,
    done: str,
) -> None:
    config = sessions.config_of(tmp_path)
    prepare(config)
    with monkeypatch.context() as patch:
        full(patch)
        with pytest.raises(StoreError, match="the disk is full"):
            sessions.opened(config)
    assert done in sessions.codes(sessions.opened(config))
    found, position = sessions.content(config)
    assert found == sessions.reference(config, *names)
    assert position.whole
    assert position.incomplete == {}
    assert sessions.codes(sessions.opened(config)) == []


def test_a_replay_whose_saves_fail_fails_and_goes_on_once_there_is_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = sessions.config_of(tmp_path)
    recording, path = sessions.record(config, 1, "a", range(PINGS)), tmp_path / "other.map"
    with monkeypatch.context() as patch:
        full(patch)
        with pytest.raises(StoreError, match="the disk is full"):
            map_into_store([recording], config, None, path)
    whole, _, counters, _ = map_into_store([recording], config, None, path)
    found = whole.sha256()
    whole.close()
    assert found == sessions.reference(config, "a")
    assert counters.pings_mapped > 0


@pytest.mark.parametrize("states", [True, False])
def test_a_map_that_lacks_a_part_without_stating_it_takes_no_session(
    tmp_path: Path, *, states: bool
) -> None:
    session = Session(tmp_path / "dive.map")
    session.keep.stop()
    incomplete = {"before": "its recordings are gone"} if states else {}
    earlier = Position("before", whole=False, sessions=("before",), incomplete=incomplete)
    keep: Any = SqlitePersistence(session.store, session.keep._map, "next", earlier)
    if states:
        keep.begin(session.engine, session.recording, lambda: None)
    else:
        with pytest.raises(StoreError, match="session before is not in the map as a whole"):
            keep.begin(session.engine, session.recording, lambda: None)
    keep.stop()
    session.store.close()
    assert session.position().session == ("next" if states else "now")
    assert session.position().place == RecordingOffset()
