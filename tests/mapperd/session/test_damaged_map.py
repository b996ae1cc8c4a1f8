"""A bit of a cleanly closed map file flips: no reader takes the brick for free or empty space."""

import sqlite3
import time
from argparse import Namespace
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.cli import mapperd as cli
from mapperd.cli.arguments import parse_arguments
from mapperd.cli.mapperctl.connection import CtlError
from mapperd.cli.mapperctl.offline import run
from mapperd.config.tree import Config
from mapperd.daemon.map_folder import write_results
from mapperd.errors import MapError, StoreError
from mapperd.events import EventLog
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.localization.known_map import load_known_map
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.replay_to_store import map_into_store
from mapperd.session.startup import OpenMap, open_map
from mapperd.session.store_session import SqlitePersistence
from mapperd.store.maintenance import Verification
from mapperd.store.map_files import map_in
from mapperd.store.position import Position, position_in
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from tests.mapperd.session.crash import test_startup as sessions
from tests.mapperd.store import dive


def flip(path: Path, bricks: int = 1) -> set[tuple[int, int, int]]:
    """Flip one bit in the data of some bricks, as a disk does: nothing else changes."""
    keys = set()
    with closing(sqlite3.connect(path)) as file:
        rows = file.execute("SELECT x, y, z, data FROM brick LIMIT ?", (bricks,)).fetchall()
    data = bytearray(path.read_bytes())
    for *key, brick in rows:
        at = data.index(brick[:64]) + 40
        data[at] ^= 0x10
        keys.add(tuple(key))
    path.write_bytes(data)
    return keys


@pytest.fixture
def config(tmp_path: Path) -> Config:
    """Settings of a map with one session that ended in good order."""
    config = sessions.config_of(tmp_path)
    sessions.record(config, 1, "a", range(12))
    sessions.mapped(config, "a")
    return config


def path_of(config: Config) -> Path:
    return Path(config.outofcore.map_path)


def forget_recordings(config: Config) -> None:
    for path in Path(config.recording.folder).glob("*"):
        path.unlink()


def opened(config: Config) -> tuple[OpenMap, EventLog]:
    events = EventLog(lambda: 0)
    return open_map(config, "new", events, {}, lambda: 1.0), events


def test_damage_after_a_clean_end_is_rebuilt_at_the_next_start(config: Config) -> None:
    before = sessions.content(config)[0]
    flip(path_of(config))
    assert sessions.codes(sessions.opened(config)) == ["bricks_rebuilt"]
    assert sessions.content(config)[0] == before == sessions.reference(config, "a")
    assert sessions.codes(sessions.opened(config)) == []


def test_without_recordings_every_start_and_every_result_names_what_is_missing(
    config: Config, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flip(path_of(config))
    forget_recordings(config)
    for _ in range(2):
        opening, events = opened(config)
        assert "bricks_lost" in sessions.codes(events)
        status = opening.persistence.status()
        assert status is not None
        assert status["bricks_lost"] == 1
        opening.close()
        whole = opening.persistence.whole()
        assert whole.bricks_lost == 1
    summary = {
        "store": {"path": str(path_of(config)), "bricks_lost": whole.bricks_lost},
        "pings_mapped": 3,
        "pings_total": 3,
        "pings_dropped": {},
        "wall_s": 1.0,
        "voxels_occupied": 5,
        "live": {"told_to_stop": True},
        "config": {"localization": {"mapping": "as_given"}},
    }
    for name in ("map.bt", "map.ply"):
        (tmp_path / name).write_bytes(b"of an earlier run")
    with closing(whole):
        write_results(tmp_path, whole, summary, TrajectoryWriter(tmp_path))
    assert (tmp_path / "summary.json").exists()
    assert not (tmp_path / "map.bt").exists()
    assert not (tmp_path / "map.ply").exists()
    assert cli._verdict(parse_arguments(["--out", str(tmp_path)]), summary) == 65
    assert "1 bricks are damaged" in capsys.readouterr().err


def test_readers_of_the_file_refuse_it(config: Config, tmp_path: Path) -> None:
    path = path_of(config)
    flip(path)
    with pytest.raises(MapError, match="1 bricks of it are damaged"):
        map_in(path, Config())
    with pytest.raises(MapError, match="1 bricks of it are damaged"):
        load_known_map(path, config)
    args = Namespace(command="convert", source=path, file=tmp_path / "map.ply", calibration=None)
    args.origin = args.min_probability = None
    args.allow_damaged = False
    with pytest.raises(CtlError, match="damaged"):
        list(run(args, Config()))
    assert not args.file.exists()
    args.allow_damaged = True
    assert list(run(args, Config()))[-1].startswith("1 damaged bricks of the map are missing")
    assert args.file.exists()


def flip_cells(path: Path, table: str) -> None:
    """Change one bit of the number of cells of the first page of a table or an index."""
    with closing(sqlite3.connect(path)) as file:
        (page,) = file.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)
        ).fetchone()
        (size,) = file.execute("PRAGMA page_size").fetchone()
    data = bytearray(path.read_bytes())
    at = (page - 1) * size + 4
    data[at] &= data[at] - 1  # fewer cells: a higher number is refused by SQLite
    path.write_bytes(data)


INDEX = "sqlite_autoindex_brick_1"


@pytest.mark.parametrize("table", ["fact", "progress", "brick", INDEX, "brick_by_revision"])
def test_readers_of_the_file_refuse_a_damaged_page(
    config: Config, tmp_path: Path, table: str
) -> None:
    path, file = path_of(config), tmp_path / "map.ply"
    flip_cells(path, table)
    with pytest.raises(StoreError, match="damaged"):
        map_in(path, Config())
    with pytest.raises(MapError, match="damaged"):
        load_known_map(path, config)
    with pytest.raises(StoreError, match="damaged"), StoreReader(path) as reader:
        list(reader.rows())
    args = Namespace(command="convert", source=path, file=file, calibration=None, origin=None)
    args.min_probability, args.allow_damaged = None, True
    with pytest.raises(CtlError, match="damaged"):
        list(run(args, Config()))
    assert not file.exists()


def test_a_damaged_setting_is_not_blamed_on_the_user(config: Config, tmp_path: Path) -> None:
    path = path_of(config)
    before = sessions.content(config)[0]
    stored = b"octree.voxel_resolution0.2"
    data = path.read_bytes()
    assert data.count(stored) == 1
    path.write_bytes(data.replace(stored, stored[:-1] + b"6"))
    with pytest.raises(StoreError, match="damaged"):
        map_in(path, Config())
    assert sessions.codes(sessions.opened(config)) == []  # the settings of the file are these
    assert sessions.content(config)[0] == before
    path.write_bytes(path.read_bytes().replace(stored, stored[:-1] + b"6"))
    other = sessions.config_of(tmp_path, "iwlo: {L_occ: 1.5}\n")
    assert sessions.codes(sessions.opened(other))[0] == "store_damaged"


def test_the_whole_map_of_a_large_damaged_file_is_refused_before_its_verification(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.session.startup.VERIFIED_FIRST_BYTES", 0)
    flip_cells(path_of(config), INDEX)
    opening, events = opened(config)
    with pytest.raises(StoreError, match="damaged"):
        opening.persistence.whole()
    opening.close()
    assert sessions.codes(events) == ["store_damaged", "map_not_verified"]
    assert sessions.codes(sessions.opened(config)) == ["store_damaged", "map_rebuilt"]
    assert sessions.content(config)[0] == sessions.reference(config, "a")


def test_a_large_file_that_a_session_left_unverified_is_verified_before_the_next(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.session.startup.VERIFIED_FIRST_BYTES", 0)
    opening, events = opened(config)
    opening.close()
    assert sessions.codes(events) == ["map_not_verified"]
    flip(path_of(config))
    assert sessions.codes(sessions.opened(config))[0] == "bricks_rebuilt"
    opening, events = opened(config)  # the file is verified, so the next session verifies again
    assert isinstance(opening.persistence, SqlitePersistence)
    opening.persistence._on_begin()
    wait_for(lambda: "map_verified" in sessions.codes(events))
    opening.close()
    assert sessions.codes(events) == ["map_verified"]
    assert not list(path_of(config).parent.glob("*.unverified"))


def test_a_large_file_is_verified_during_the_session(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.session.startup.VERIFIED_FIRST_BYTES", 0)
    flip(path_of(config))
    opening, events = opened(config)
    assert isinstance(opening.persistence, SqlitePersistence)
    opening.persistence._on_begin()
    wait_for(lambda: "map_verified" in sessions.codes(events))
    store = opening.persistence.store
    assert store is not None
    assert not store.lost
    opening.persistence._report_damage()  # as between two pings
    assert len(store.lost) == 1
    opening.close()
    assert sessions.codes(events) == ["map_verified", "bricks_lost"]
    assert sessions.codes(sessions.opened(config))[0] == "bricks_rebuilt"
    assert sessions.content(config)[0] == sessions.reference(config, "a")


def test_a_large_file_with_a_damaged_index_is_rebuilt_at_the_next_start(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = path_of(config)
    with closing(sqlite3.connect(path)) as file:
        (page,) = file.execute(
            "SELECT rootpage FROM sqlite_master WHERE name LIKE 'sqlite_autoindex_brick%'"
        ).fetchone()
        (size,) = file.execute("PRAGMA page_size").fetchone()
    data = bytearray(path.read_bytes())
    data[page * size - 3] ^= 0x01  # a key in the index: a look-up would find nothing
    path.write_bytes(data)
    monkeypatch.setattr("mapperd.session.startup.VERIFIED_FIRST_BYTES", 0)
    opening, events = opened(config)
    assert isinstance(opening.persistence, SqlitePersistence)
    opening.persistence._on_begin()
    wait_for(lambda: "store_damaged" in sessions.codes(events))
    opening.close()
    assert sessions.codes(sessions.opened(config)) == ["store_damaged", "map_rebuilt"]
    assert sessions.content(config)[0] == sessions.reference(config, "a")


def wait_for(condition: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def test_a_replay_into_a_damaged_file_rebuilds_it(
    tmp_path: Path, survey: Callable[..., list[Any]], write_recording: Callable[..., object]
) -> None:
    recording, path = tmp_path / "dive.mcap", tmp_path / "dive.map"
    write_recording(recording, survey(10))
    config = sessions.config_of(tmp_path)
    whole = map_into_store([recording], config, None, path)[0].sha256()
    flip(path)
    assert map_into_store([recording], config, None, path)[0].sha256() == whole
    other = tmp_path / "other.mcap"
    write_recording(other, survey(14))
    map_into_store([other], config, None, path)
    flip(path)
    with pytest.raises(StoreError, match="1 bricks are damaged") as refused:
        map_into_store([recording], config, None, path)
    assert refused.value.reason == "bricks_lost"


def test_damage_behind_a_tile_in_memory_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path, cache_tiles=1000)
    with store:
        dive.dive_on(sonar_map, store, 0, 20)
        store.save()
    sonar_map, store = dive.open_store(path, cache_tiles=1000)
    with store:
        dive.dive_on(sonar_map, store, 20, 40)
        store.save()
        resident = {key for key, _, _ in sonar_map.core.bricks_since(0)[1]}
        key = min(resident)
        store._saver._connection.execute(
            "UPDATE brick SET data = x'00' WHERE (x, y, z) = (?, ?, ?)", key
        )
        store.suspect([key])
        store.settle_suspects()
        assert not store.lost
    whole = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        assert not reader.load(whole).lost
    assert whole.sha256() == dive.mapped(40).sha256()


def test_the_verification_ends_with_the_store(tmp_path: Path) -> None:
    sonar_map, store = dive.open_store(tmp_path / "dive.map")
    with store:
        dive.dive_on(sonar_map, store, 0, 20)
        assert isinstance(store, TileStore)
        ended: list[object] = []
        Verification(store, ended.append).stop()
        verification = Verification(store, ended.append)
        verification.start()
        wait_for(lambda: verification.state == "done")
        verification.stop()
        assert ended[-1] is None


def test_a_changed_byte_of_the_position_is_noticed() -> None:
    config = {"octree": {"voxel_resolution": 0.2}, "outofcore": {"use": True}}
    position = Position("b", whole=False, sessions=("a", "b"), done=7, config=config)
    data = position.encoded()
    assert msgspec.structs.replace(position_of(data), crc=None) == position
    for at in range(len(data)):
        for bit in (0x01, 0x10, 0x80):
            changed = data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]
            with suppress(StoreError):
                assert msgspec.structs.replace(position_of(changed), crc=None) == position, at


def position_of(data: bytes) -> Position:
    position = position_in(data)
    assert position is not None
    return position
