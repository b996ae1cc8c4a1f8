import sqlite3
from pathlib import Path

import pytest

from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.database import STEPS, VERSION, migrate, open_writer
from mapperd.store.reader import StoreReader
from tests.mapperd.store import dive


def make_store(path: Path) -> bytes:
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, 20)
    return content(path)


def content(path: Path) -> bytes:
    sonar_map = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        reader.load(sonar_map)
    return sonar_map.core.encode_map()


def version_of(path: Path) -> int:
    connection = sqlite3.connect(path)
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    connection.close()
    return int(version)


def add_a_column(connection: sqlite3.Connection) -> None:
    connection.execute("ALTER TABLE brick ADD COLUMN seen INTEGER NOT NULL DEFAULT 0")


def fail_half_way(connection: sqlite3.Connection) -> None:
    add_a_column(connection)
    connection.execute("DROP TABLE brick")
    raise sqlite3.OperationalError("no more")


def test_an_older_file_becomes_one_of_today_and_keeps_its_map(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    before = make_store(path)
    connection = open_writer(path)
    migrate(connection, path, (*STEPS, add_a_column))
    migrate(connection, path, (*STEPS, add_a_column))  # nothing is left to be done
    connection.close()
    assert version_of(path) == VERSION + 1
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA user_version = {VERSION}")
    connection.close()
    assert content(path) == before


def test_a_migration_that_fails_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    before = make_store(path)
    connection = open_writer(path)
    with pytest.raises(sqlite3.OperationalError, match="no more"):
        migrate(connection, path, (*STEPS, fail_half_way))
    connection.close()
    assert version_of(path) == VERSION
    assert content(path) == before


def test_a_file_of_a_newer_version_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    connection = open_writer(path)
    migrate(connection, path, (*STEPS, add_a_column))
    connection.close()
    before = path.read_bytes()
    with pytest.raises(StoreError) as refused:
        dive.open_store(path)
    assert refused.value.reason == "newer_version"
    assert f"version {VERSION + 1}" in str(refused.value)
    with pytest.raises(StoreError, match="is of version"), StoreReader(path):
        pass
    assert path.read_bytes() == before


def test_an_empty_file_becomes_a_store(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    path.touch()
    assert make_store(path) == dive.mapped(20).core.encode_map()


def test_a_kill_while_the_file_is_made_leaves_nothing_half_made(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    connection = open_writer(path)
    connection.execute("BEGIN IMMEDIATE")
    STEPS[0](connection)
    connection.close()  # without a commit
    assert make_store(path) == dive.mapped(20).core.encode_map()
