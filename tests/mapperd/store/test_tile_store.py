import sqlite3
import struct
import threading
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mapperd import _core
from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import MapError, StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import Loaded, StoreReader
from mapperd.store.tile_store import TileStore, tile_bricks
from tests.mapperd.store.dive import (
    CONFIG,
    dive_on,
    echo_of,
    integrate,
    mapped,
    next_ping,
    open_store,
)

PINGS = 130
CHUNK = 256 * 64 * 3  # bytes: cells of 4 x 4 x 4 voxels, each log-odds and a count


@pytest.fixture(scope="module")
def reference() -> bytes:
    return mapped(PINGS).core.encode_map()


def stored(path: Path) -> tuple[bytes, Loaded]:
    sonar_map = SonarMap(CONFIG)
    with StoreReader(path) as reader:
        loaded = reader.load(sonar_map)
    return sonar_map.core.encode_map(), loaded


@pytest.mark.parametrize(("tile_size_m", "cache_tiles"), [(6.4, 1), (6.4, 3), (20.0, 1), (1.0, 5)])
def test_map_of_a_tiny_cache_equals_the_one_in_memory_to_the_bit(
    tmp_path: Path, reference: bytes, tile_size_m: float, cache_tiles: int
) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path, tile_size_m=tile_size_m, cache_tiles=cache_tiles)
    with store:
        dive_on(sonar_map, store, 0, PINGS)
        assert len(store._tiles) <= max(cache_tiles, 12)
        assert store.counters.tiles_dropped > 5
        assert store.counters.tiles_loaded > store.counters.tiles_dropped
        assert len(sonar_map.core.encode_map()) < len(reference)
    content, loaded = stored(path)
    assert content == reference
    assert loaded.position == struct.pack("<Q", PINGS)
    assert loaded.lost == frozenset()


def test_map_of_the_arc_rule_in_tiles_equals_the_one_in_memory(tmp_path: Path) -> None:
    config = with_values(CONFIG, {"mapping.rule": "arc"})
    path, whole, part = tmp_path / "dive.map", SonarMap(config), SonarMap(config)
    with TileStore(path, part, tile_size_m=6.4, cache_tiles=1) as store:
        dive_on(part, store, 0, 60)
        assert store.counters.tiles_dropped > 5
    for number in range(60):
        integrate(whole, number)
    assert whole.counts().occupied > 100
    read = SonarMap(config)
    with StoreReader(path) as reader:
        reader.load(read)
    assert read.sha256() == whole.sha256()


@pytest.mark.slow
def test_memory_is_bounded_by_the_cache(tmp_path: Path) -> None:
    pings = 3 * PINGS
    whole = mapped(pings).memory_bytes
    empty = SonarMap(CONFIG).memory_bytes  # the rule's tables
    sonar_map, store = open_store(tmp_path / "dive.map", tile_size_m=6.4, cache_tiles=1)
    most = 0
    with store:
        for number in range(pings):
            dive_on(sonar_map, store, number, number + 1)
            most = max(most, sonar_map.memory_bytes)
            if number % 10 == 0:
                held = SonarMap(CONFIG)
                held.core.load_map(sonar_map.core.encode_map())
                # Dropped cells are given back when they are more than those in use and a chunk.
                assert sonar_map.memory_bytes - empty <= 2 * (held.memory_bytes - empty) + CHUNK
    assert most < whole / 4


def test_map_goes_on_where_it_was_saved_whatever_the_tiles_are_now(
    tmp_path: Path, reference: bytes
) -> None:
    path = tmp_path / "dive.map"
    begin = 0
    for end, tile_size_m in ((40, 6.4), (41, 13.0), (90, 30.0), (PINGS, 6.4)):
        sonar_map, store = open_store(path, tile_size_m=tile_size_m)
        with store:
            assert next_ping(store) == begin
            dive_on(sonar_map, store, begin, end)
        begin = end
    assert stored(path)[0] == reference


def test_a_new_place_is_saved_after_a_restart_too(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    whole = mapped(30)
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 30)
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 1000, 1003)  # forty metres away
    for number in range(1000, 1003):
        integrate(whole, number)
    assert stored(path)[0] == whole.core.encode_map()


def test_what_was_not_saved_is_as_if_it_had_never_been(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with pytest.raises(MapError), store:  # noqa: PT012 what comes before is the point
        dive_on(sonar_map, store, 0, 60)
        sonar_map.integrate(echo_of(0), np.zeros((4, 4)))
    content, loaded = stored(path)
    (pings,) = struct.unpack("<Q", loaded.position)
    assert pings == 58
    assert content == mapped(pings).core.encode_map()


def test_snapshots_are_written_by_another_thread_while_pings_go_on(
    tmp_path: Path, reference: bytes
) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        writers = []
        for number in range(PINGS):
            integrate(sonar_map, number)
            store.advance(struct.pack("<Q", number + 1))
            if number % 10 == 0:
                writers.append(threading.Thread(target=store.write, args=(store.take(),)))
                writers[-1].start()
        for writer in writers:
            writer.join()
    assert stored(path)[0] == reference


def test_an_older_snapshot_does_not_undo_a_newer_one(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 2)
        older = store.take()
        dive_on(sonar_map, store, 2, 5)
        store.save()
        store.write(older)
        content, loaded = stored(path)
        assert struct.unpack("<Q", loaded.position) == (5,)
        assert content == mapped(5).core.encode_map()


def test_a_change_that_nobody_placed_in_the_input_is_not_saved(tmp_path: Path) -> None:
    sonar_map, store = open_store(tmp_path / "dive.map")
    integrate(sonar_map, 0)
    with pytest.raises(StoreError) as refused:
        store.save()
    assert refused.value.reason == "out_of_step"
    store.close()


def test_only_what_changed_is_written(tmp_path: Path) -> None:
    sonar_map, store = open_store(tmp_path / "dive.map", cache_tiles=100)
    with store:
        dive_on(sonar_map, store, 0, 40)
        store.save()
        before = store._saver.bricks_written
        store.save()
        assert store._saver.bricks_written == before
        dive_on(sonar_map, store, 40, 41)
        store.save()
        (bricks,) = store._loader._connection.execute("SELECT count(*) FROM brick").fetchone()
        assert 0 < store._saver.bricks_written - before < bricks / 3


def test_reset_empties_the_map_and_the_file_and_keeps_the_place(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 30)
        store.reset()
        assert stored(path)[0] == SonarMap(CONFIG).core.encode_map()
        assert stored(path)[1].position == struct.pack("<Q", 30)
        dive_on(sonar_map, store, 30, 60)
    late = SonarMap(CONFIG)
    for number in range(30, 60):
        integrate(late, number)
    assert stored(path)[0] == late.core.encode_map()


def with_section(section: str, **changes: object) -> Config:
    changed = msgspec.structs.replace(getattr(CONFIG, section), **changes)
    return msgspec.structs.replace(CONFIG, **{section: changed})


@pytest.mark.parametrize(
    ("config", "stated"),
    [
        (
            with_section("octree", voxel_resolution=0.05),
            "voxel_resolution is 0.1 in it, 0.05",
        ),
        (with_section("iwlo", L_max=9.0), "iwlo.L_max is 10.0 in it, 9.0"),
        (with_section("adaptive", min_ratio=0.0), "adaptive.min_ratio is 0.25 in it, 0.0"),
    ],
)
def test_other_parameters_are_refused_by_name_and_nothing_is_touched(
    tmp_path: Path, config: Config, stated: str
) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 5)
    before = path.read_bytes()
    with pytest.raises(StoreError) as refused:
        TileStore(path, SonarMap(config), tile_size_m=6.4, cache_tiles=2)
    assert refused.value.reason == "other_parameters"
    assert stated in str(refused.value)
    with StoreReader(path) as reader, pytest.raises(StoreError, match="of other settings"):
        reader.load(SonarMap(config))
    assert path.read_bytes() == before


def test_a_second_writer_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        with pytest.raises(StoreError) as refused:
            open_store(path)
        assert refused.value.reason == "in_use"
        dive_on(sonar_map, store, 0, 3)
    assert stored(path)[0] == mapped(3).core.encode_map()


def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path: Path) -> None:
    junk, foreign = tmp_path / "junk", tmp_path / "foreign"
    junk.write_bytes(b"no database at all, but long enough to look at" * 100)
    with sqlite3.connect(foreign) as connection:
        connection.execute("CREATE TABLE brick (x)")
    connection.close()
    for path in (junk, foreign):
        before = path.read_bytes()
        with pytest.raises(StoreError) as refused:
            open_store(path)
        assert refused.value.reason == "not_a_store"
        if path is junk:
            assert path.read_bytes() == before
        with pytest.raises(StoreError), StoreReader(path):
            pass


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be made"):
        open_store(tmp_path / "nowhere" / "dive.map")
    with pytest.raises(StoreError) as refused, StoreReader(tmp_path / "nothing"):
        pass
    assert refused.value.reason == "cannot_open"


def test_a_part_is_not_taken_for_the_whole(tmp_path: Path) -> None:
    octomap = mapped(1).octomap_bt()
    sonar_map, store = open_store(tmp_path / "dive.map")
    with store:
        dive_on(sonar_map, store, 0, 3)
        for whole in (
            sonar_map.sha256,
            sonar_map.octomap_bt,
            sonar_map.octomap_ot,
            lambda: sonar_map.save(tmp_path / "copy"),
            lambda: sonar_map.load(tmp_path / "copy"),
            lambda: sonar_map.load_octomap(octomap),
        ):
            with pytest.raises(MapError) as refused:
                whole()
            assert refused.value.reason == "in_tiles"
        with pytest.raises(RuntimeError, match="not in memory"):
            sonar_map.core.set_log_odds(np.array([[500.0, 0.0, 0.0]]), np.array([1.0]))
        assert len(sonar_map.voxels("occupied")) > 0


def test_the_core_asks_a_store_that_is_gone_in_vain(tmp_path: Path) -> None:
    sonar_map, store = open_store(tmp_path / "dive.map")
    store.close()
    del store
    with pytest.raises(StoreError) as refused:
        integrate(sonar_map, 0)
    assert refused.value.reason == "closed"


def test_a_tile_has_the_whole_number_of_bricks_nearest_to_its_size() -> None:
    for tile_size_m, resolution_m in ((10.0, 0.05), (10.0, 0.1), (10.0, 0.02), (0.4, 0.2)):
        brick_m = _core.BRICK_VOXELS * resolution_m
        bricks = tile_bricks(tile_size_m, resolution_m)
        others = range(1, 100)
        assert abs(bricks * brick_m - tile_size_m) == min(
            abs(other * brick_m - tile_size_m) for other in others
        )
