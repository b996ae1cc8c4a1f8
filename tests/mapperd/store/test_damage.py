"""Damage on disk is found, kept, reported and rebuilt; it never silently becomes free space."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.maintenance import put_aside, rebuild_lost
from mapperd.store.reader import StoreReader
from mapperd.store.tiles import Key, pack
from tests.mapperd.store import dive

PINGS = 60


def make_store(path: Path, pings: int = PINGS) -> None:
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, pings)


def content(path: Path) -> tuple[bytes, frozenset[Key]]:
    sonar_map = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        lost = reader.load(sonar_map).lost
    return sonar_map.core.encode_map(), lost


def damage(path: Path, change: str, every: int = 3) -> set[Key]:
    """Change the rows of every third brick behind the store's back."""
    connection = sqlite3.connect(path)
    with connection:
        keys = connection.execute("SELECT x, y, z FROM brick ORDER BY x, y, z").fetchall()[::every]
        for key in keys:
            connection.execute(f"UPDATE brick SET {change} WHERE (x, y, z) = (?, ?, ?)", key)  # noqa: S608
    connection.close()
    return set(keys)


CHANGES = [
    "data = CAST(substr(data, 1, length(data) - 1) || x'00ff' AS BLOB)",
    "data = CAST(substr(data, 1, 100) AS BLOB)",
    "data = x''",
    "crc = crc + 1",
    "size = size + 1",
    "size = 1 << 40",
    "revision = revision + 1",
    "revision = -5",
]


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_row_is_quarantined_and_rebuilt_from_the_recordings(
    tmp_path: Path, change: str
) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    whole = content(path)[0]
    keys = damage(path, change)
    assert content(path)[1] == keys  # the reader reports it, too

    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, PINGS, PINGS + 20)  # over some of them
        met = store.lost
        assert met
        assert met <= keys
        assert store.status()["bricks_lost"] == len(met)
        with pytest.raises(ValueError, match="in memory"):
            store.check()
    partial, lost = content(path)
    assert lost == keys
    assert partial != dive.mapped(PINGS + 20).core.encode_map()
    assert partial != whole

    sonar_map, store = dive.open_store(path)
    with store:
        assert store.lost == met
        assert store.check() == keys
        assert rebuild_lost(store, sonar_map, map_again(PINGS + 20)) == len(keys)
        assert store.lost == frozenset()
        dive.dive_on(sonar_map, store, PINGS + 20, PINGS + 25)
    assert content(path) == (dive.mapped(PINGS + 25).core.encode_map(), frozenset())


def map_again(pings: int, begin: int = 0) -> Callable[[SonarMap], bool]:
    def again(scratch: SonarMap) -> bool:
        for number in range(begin, pings):
            dive.integrate(scratch, number)
        return begin == 0

    return again


def test_a_row_with_a_true_checksum_may_still_be_no_brick(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    make_store(path, 50)
    whole = content(path)[0]
    sonar_map, store = dive.open_store(path)
    with store:
        columns = "x, y, z, revision FROM brick ORDER BY x LIMIT 1"
        *key, revision = store._loader._connection.execute(f"SELECT {columns}").fetchone()
        row = pack(store._saver._compressor, tuple(key), revision, b"\x02\x00nonsense")
        store._saver._connection.execute(
            "UPDATE brick SET size = ?, crc = ?, data = ? WHERE (x, y, z) = (?, ?, ?)",
            (row.size, row.crc, row.data, *key),
        )
        tile = tuple(i // store._loader._edge for i in key)
        store._fetch([tile])
        assert store.lost == {tuple(key)}
    assert content(path)[0] != whole
    sonar_map, store = dive.open_store(path)
    with store:
        rebuild_lost(store, sonar_map, map_again(50))
    assert content(path) == (whole, frozenset())


def test_what_incomplete_recordings_give_is_kept_and_the_rest_stays_on_record(
    tmp_path: Path,
) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    keys = damage(path, "crc = 0", every=1)
    sonar_map, store = dive.open_store(path)
    with store:
        assert store.check() == keys
    sonar_map, store = dive.open_store(path)
    with store:
        rebuild_lost(store, sonar_map, map_again(PINGS, begin=20))
        assert store.lost == keys
    late = SonarMap(dive.CONFIG)
    for number in range(20, PINGS):
        dive.integrate(late, number)
    assert content(path) == (late.core.encode_map(), frozenset(keys))


def test_the_damaged_row_is_kept_as_it_was_until_it_is_rebuilt(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    make_store(path, 30)
    (key,) = damage(path, "data = x'00010203'", every=10**6)
    sonar_map, store = dive.open_store(path)
    with store:
        store.check()
    look = "SELECT x, y, z, data, reason, rebuilt FROM quarantine"
    (row,) = sqlite3.connect(path).execute(look).fetchall()
    assert row == (*key, b"\0\1\2\3", "the checksum is wrong", 0)
    sonar_map, store = dive.open_store(path)
    with store:
        rebuild_lost(store, sonar_map, map_again(30))
    (row,) = sqlite3.connect(path).execute(look).fetchall()
    assert row == (*key, None, "the checksum is wrong", 1)


def test_rebuilding_takes_no_more_memory_than_what_is_rebuilt(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    damage(path, "crc = 0", every=10**6)
    sonar_map, store = dive.open_store(path)
    most = []

    def again(scratch: SonarMap) -> bool:
        for number in range(PINGS):
            dive.integrate(scratch, number)
            most.append(scratch.memory_bytes)
        return True

    with store:
        store.check()
        assert len(store.lost) == 1
    sonar_map, store = dive.open_store(path)
    with store:
        rebuild_lost(store, sonar_map, again)
    assert max(most) < dive.mapped(PINGS).memory_bytes / 2


def check_and_dive(path: Path) -> None:
    sonar_map, store = dive.open_store(path)
    with store:
        store.check()
        dive.dive_on(sonar_map, store, PINGS, PINGS + 20)


@pytest.mark.parametrize("page", [0, 1, 2, 3])
def test_a_damaged_structure_is_refused_and_a_new_file_takes_over(
    tmp_path: Path, page: int
) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    whole = content(path)[0]
    data = bytearray(path.read_bytes())
    data[4096 * page : 4096 * page + 4096] = bytes([0xA5] * 4096)
    path.write_bytes(data)
    with pytest.raises(StoreError) as refused:
        check_and_dive(path)
    assert refused.value.reason in ("damaged", "not_a_store")
    aside = put_aside(path)
    assert aside.read_bytes()[4096 * page] == 0xA5
    assert not path.exists()
    make_store(path)
    assert content(path)[0] == whole
    assert put_aside(path).name == "dive.map.damaged-2"


def test_a_file_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    make_store(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(StoreError) as refused:
        check_and_dive(path)
    assert refused.value.reason == "damaged"
