"""A second process reads while the first one writes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import BRICK_VOXELS, StoreReader
from tests.mapperd.store import dive

ROOT = Path(__file__).resolve().parents[3]
PINGS = 100


def test_a_second_process_sees_whole_states_only_and_can_follow(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, 1)
    command = [sys.executable, "-m", "tests.mapperd.store.dive", str(path), str(PINGS)]
    truth = SonarMap(dive.CONFIG)
    follower = SonarMap(dive.CONFIG)
    at = seen = revision = 0
    with (
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL) as writer,  # noqa: S603
        StoreReader(path) as reader,
    ):
        while writer.poll() is None:
            whole = SonarMap(dive.CONFIG)
            loaded = reader.load(whole)
            pings = int.from_bytes(loaded.position, "little")
            for number in range(at, pings):
                dive.integrate(truth, number)
            seen += pings > at
            at = pings
            assert whole.core.encode_map() == truth.core.encode_map()
        revision = reader.load(follower, revision).revision
        assert follower.core.encode_map() == dive.mapped(PINGS).core.encode_map()
    assert writer.returncode == 0
    assert seen > 3


def test_a_reader_that_holds_on_does_not_hold_up_the_writer(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store, StoreReader(path) as reader:
        dive.dive_on(sonar_map, store, 0, 10)
        store.save()
        reader._connection.execute("BEGIN")
        (before,) = reader._connection.execute("SELECT revision FROM progress").fetchone()
        dive.dive_on(sonar_map, store, 10, 40)
        store.save()
        assert store.trouble is None
        assert reader._connection.execute("SELECT revision FROM progress").fetchone() == (before,)
        reader._connection.execute("COMMIT")


def test_what_is_saved_while_a_reader_reads_is_for_the_next_time(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    truth, read = dive.mapped(10), SonarMap(dive.CONFIG)
    with store, StoreReader(path) as reader:
        dive.dive_on(sonar_map, store, 0, 10)
        store.save()

        def save_more(statement: str) -> None:
            if "FROM brick" in statement:
                dive.dive_on(sonar_map, store, 10, 20)
                store.save()

        reader._connection.set_trace_callback(save_more)
        position = reader.load(read).position
        reader._connection.set_trace_callback(None)
        assert store.position == b""
        assert int.from_bytes(position, "little") == 10
        assert read.core.encode_map() == truth.core.encode_map()


def test_a_follower_is_given_what_changed_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    follower, truth = SonarMap(dive.CONFIG), SonarMap(dive.CONFIG)
    revision, bricks = 0, []
    with store, StoreReader(path) as reader:
        for begin in range(0, 100, 20):
            dive.dive_on(sonar_map, store, begin, begin + 20)
            store.save()
            loaded = reader.load(follower, revision)
            revision = loaded.revision
            bricks.append(loaded.bricks)
            for number in range(begin, begin + 20):
                dive.integrate(truth, number)
            assert follower.core.encode_map() == truth.core.encode_map()
        assert reader.load(follower, revision).bricks == 0
        (total,) = reader._connection.execute("SELECT count(*) FROM brick").fetchone()
    assert max(bricks[2:]) < total


def test_a_reader_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, 20)
    before = path.read_bytes()
    with StoreReader(path) as reader:
        reader.load(SonarMap(dive.CONFIG))
        with pytest.raises(Exception, match="readonly"):
            reader._connection.execute("DELETE FROM brick")
    assert path.read_bytes() == before


def test_boxes_side_by_side_are_the_whole_map(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, 20)
    whole, parts = SonarMap(dive.CONFIG), SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        reader.load(whole)
        keys = reader.keys()
        (x, y, z), (far_x, far_y, far_z) = keys.min(axis=0).tolist(), keys.max(axis=0).tolist()
        assert far_x > x + 1
        part = SonarMap(dive.CONFIG)
        assert reader.load_box(part, (x + 1, y, z), (far_x, far_y, far_z)) == frozenset()
        assert 0 < part.core.known_count() < whole.core.known_count()
        centres_m, _, _ = part.core.voxels()
        assert centres_m[:, 0].min() > (x + 1) * BRICK_VOXELS * part.resolution_m
        for low, high in (((x, y, z), (x, far_y, far_z)), ((x + 1, y, z), (far_x, far_y, far_z))):
            reader.load_box(parts, low, high)
    assert parts.core.encode_map() == whole.core.encode_map()
    of_whole = np.unique(whole.core.blocks()[0] // (BRICK_VOXELS // 16), axis=0)
    assert (keys == of_whole).all()


def test_damage_in_a_box_is_reported_by_its_brick(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    with store:
        dive.dive_on(sonar_map, store, 0, 10)
        key = store._saver._connection.execute("SELECT x, y, z FROM brick").fetchone()
        store._saver._connection.execute(
            "UPDATE brick SET crc = crc + 1 WHERE (x, y, z) = (?, ?, ?)", key
        )
    with StoreReader(path) as reader:
        everywhere = (-99, -99, -99), (99, 99, 99)
        assert reader.load_box(SonarMap(dive.CONFIG), *everywhere) == {key}
        beside = (key[0] + 1, -99, -99), (99, 99, 99)
        assert reader.load_box(SonarMap(dive.CONFIG), *beside) == frozenset()
        assert list(key) in reader.keys().tolist()
