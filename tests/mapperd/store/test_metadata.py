"""The checksum of the settings, the revision, the position and the lost bricks of a map file."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.database import VERSION
from mapperd.store.maintenance import packed, write_whole
from mapperd.store.map_files import map_in
from mapperd.store.reader import StoreReader
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from tests.mapperd.store import dive

PINGS = 12


def read_by_reader(path: Path) -> None:
    with StoreReader(path) as reader:
        reader.load(SonarMap(dive.CONFIG))


def read_its_settings(path: Path) -> None:
    with StoreReader(path) as reader:
        reader.kind()


def read_stored_map(path: Path) -> None:
    StoredMap(path, dive.CONFIG).close()


def read_source(path: Path) -> None:
    map_in(path, Config()).map.close()


READERS = [read_by_reader, read_its_settings, read_stored_map, read_source]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A map file that was closed in good order."""
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, PINGS)
    return path


def content(path: Path) -> str:
    sonar_map = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        reader.load(sonar_map)
    return sonar_map.sha256()


def change(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


CHANGES = [
    "UPDATE fact SET value = '0.6' WHERE name = 'octree.voxel_resolution'",
    "UPDATE fact SET name = 'octree.voxel_resolutioo' WHERE name = 'octree.voxel_resolution'",
    "DELETE FROM fact WHERE name LIKE 'iwlo.%'",
    "UPDATE progress SET revision = revision + 1",
    "UPDATE progress SET position = x''",
    "UPDATE progress SET checksum = checksum + 1",
    "DELETE FROM progress",
    "INSERT INTO quarantine (x, y, z, reason) VALUES (0, 0, 0, '')",
]


@pytest.mark.parametrize("statement", CHANGES)
@pytest.mark.parametrize("read", READERS)
def test_a_change_behind_the_back_of_the_store_is_damage(
    path: Path, statement: str, read: Callable[[Path], None]
) -> None:
    read(path)
    change(path, statement)
    with pytest.raises(StoreError, match="damaged") as refused:
        read(path)
    assert refused.value.reason == "damaged"


def test_a_lost_brick_stays_lost(path: Path) -> None:
    change(path, "UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    sonar_map, store = dive.open_store(path)
    with store:
        assert len(store.check()) == 1
        dive.dive_on(sonar_map, store, PINGS, PINGS + 1)
    with closing(StoredMap(path, dive.CONFIG)) as whole:
        assert whole.bricks_lost == 1
    change(path, "UPDATE quarantine SET rebuilt = 1")
    with pytest.raises(StoreError, match="lost bricks"):
        StoredMap(path, dive.CONFIG)


def test_damaged_settings_are_restored_from_equal_ones(path: Path) -> None:
    before = content(path)
    change(path, CHANGES[0])
    other = with_values(dive.CONFIG, {"octree.voxel_resolution": 0.6})
    with pytest.raises(StoreError) as refused:
        TileStore(path, SonarMap(other), tile_size_m=6.4, cache_tiles=2)
    assert refused.value.reason == "damaged"  # and not: set them back
    _, store = dive.open_store(path)
    store.close()
    assert content(path) == before
    read_source(path)


def make_version_1(path: Path) -> None:
    change(path, "ALTER TABLE progress DROP COLUMN checksum", "PRAGMA user_version = 1")


def test_a_file_of_version_1_is_read_and_gets_a_checksum_when_it_is_opened_to_be_written(
    path: Path,
) -> None:
    assert VERSION > 1
    before = content(path)
    assert map_in(path, Config()).has_checksum
    make_version_1(path)
    for read in READERS:
        read(path)
    assert content(path) == before
    assert not map_in(path, Config()).has_checksum
    _, store = dive.open_store(path)
    assert not store.had_checksum
    store.close()
    assert map_in(path, Config()).has_checksum
    assert content(path) == before
    _, store = dive.open_store(path)
    assert store.had_checksum
    store.close()


@pytest.mark.parametrize("value", [b"\xff", "{", 7])
@pytest.mark.parametrize("read", [read_its_settings, read_source])
def test_damaged_settings_of_version_1_are_refused_in_one_line(
    path: Path, value: object, read: Callable[[Path], None]
) -> None:
    make_version_1(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE other (name TEXT PRIMARY KEY, value) WITHOUT ROWID")
        connection.execute("INSERT INTO other SELECT * FROM fact")
        connection.execute("DROP TABLE fact")
        connection.execute("ALTER TABLE other RENAME TO fact")
        connection.execute(
            "UPDATE fact SET value = ? WHERE name = 'octree.voxel_resolution'", (value,)
        )
    with pytest.raises(StoreError, match="damaged"):
        read(path)


def test_files_that_are_written_as_a_whole_have_a_checksum(tmp_path: Path, path: Path) -> None:
    sonar_map = dive.mapped(PINGS)
    whole = tmp_path / "whole.map"
    rows = packed(sonar_map.core.bricks_since(0)[1])
    write_whole(whole, dive.CONFIG, sonar_map.core.revision, rows)
    assert map_in(whole, Config()).has_checksum
    assert content(whole) == content(path)
    change(whole, CHANGES[0])
    with pytest.raises(StoreError, match="damaged"):
        read_source(whole)
