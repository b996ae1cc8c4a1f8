"""A map's file that is written at once is the file of the same map that was saved ping by ping."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.maintenance import packed, write_whole
from mapperd.store.metadata import write_checksum
from mapperd.store.reader import StoreReader
from mapperd.store.tiles import BrickRow
from tests.mapperd.store.dive import CONFIG, dive_on, mapped, open_store

PINGS = 12


def rows_in(path: Path) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(path)
    found = connection.execute("SELECT * FROM brick ORDER BY x, y, z").fetchall()
    connection.close()
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "whole.db"
    revision, bricks = mapped(PINGS).core.bricks_since(0)
    assert write_whole(path, CONFIG, revision, packed(bricks)) == len(bricks) > 2
    return path


def test_it_is_the_file_of_the_dive(whole: Path, tmp_path: Path) -> None:
    sonar_map, store = open_store(tmp_path / "dive.db")
    with store:
        dive_on(sonar_map, store, 0, PINGS)
    assert rows_in(whole) == rows_in(tmp_path / "dive.db")
    read = SonarMap(CONFIG)
    with StoreReader(whole) as reader:
        loaded = reader.load(read)
    assert (loaded.revision, loaded.lost) == (PINGS, frozenset())
    assert read.sha256() == mapped(PINGS).sha256()


def test_mapping_goes_on_in_it(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "more.db"
    with StoreReader(whole) as reader:
        write_whole(path, CONFIG, PINGS, reader.rows())
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, PINGS, PINGS + 4)
    read = SonarMap(CONFIG)
    with StoreReader(path) as reader:
        assert reader.load(read).revision == PINGS + 4
    assert read.sha256() == mapped(PINGS + 4).sha256()


def test_a_brick_twice_is_refused(whole: Path, tmp_path: Path) -> None:
    with StoreReader(whole) as reader:
        rows = list(reader.rows())
    with pytest.raises(StoreError, match="UNIQUE"):
        write_whole(tmp_path / "twice.db", CONFIG, PINGS, [*rows, rows[0]])


def test_damaged_rows_are_not_handed_on(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.db"
    with StoreReader(whole) as reader:
        rows = list(reader.rows())
    bad = BrickRow(rows[1].key, rows[1].revision + 1, rows[1].size, rows[1].crc, rows[1].data)
    write_whole(path, CONFIG, PINGS, [rows[0], bad, *rows[2:]])
    with StoreReader(path) as reader, pytest.raises(StoreError, match="checksum is wrong"):
        list(reader.rows())


def test_a_file_with_lost_bricks_is_not_handed_on(whole: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(whole, tmp_path / "lost.db"))
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(
            "INSERT INTO quarantine (x, y, z, reason) SELECT x, y, z, 'test' FROM brick LIMIT 1"
        )
        file.execute("DELETE FROM brick WHERE rowid IN (SELECT rowid FROM brick LIMIT 1)")
        write_checksum(file)
    with StoreReader(path) as reader, pytest.raises(StoreError, match="new file") as refused:
        next(reader.rows())
    assert refused.value.reason == "bricks_lost"
