"""Clients of a map whose file holds more than memory does."""

import itertools
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server import map_index
from mapperd.server import map_source as source_module
from mapperd.server.map_source import MapSource
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from mapperd.wire.messages import Interest
from tests.mapperd.server.sent_state import (
    SECOND_NS,
    Client,
    SentState,
    expected,
    look_until_indexed,
)
from tests.mapperd.store.dive import CONFIG, dive_on, integrate, open_store

LEVELS = [Interest(level=level, detail="counts") for level in range(4)]


@dataclass
class Kept:
    store: TileStore | None


class Daemon:
    """One program that has the map."""

    def __init__(self, path: Path) -> None:
        self.map, self.store = open_store(path)
        self.source = MapSource(self.map, Kept(self.store), log_odds_step=0.25)
        self.second = 0

    def look(self, position_m: tuple[float, float, float] | None = None) -> None:
        self.second += 1
        self.source.look(self.second * SECOND_NS, position_m)
        assert self.source.trouble is None

    def dive(self, begin: int, end: int) -> None:
        dive_on(self.map, self.store, begin, end)

    def expected(self, client: Client) -> SentState:
        self.store.save()
        whole = SonarMap(CONFIG)
        with StoreReader(self.store.path) as reader:
            reader.load(whole)
        return expected(whole.core, self.source.info(), client.interest)


@contextmanager
def daemon_of(path: Path, *, stops_well: bool = True) -> Iterator[Daemon]:
    daemon = Daemon(path)
    try:
        yield daemon
        if stops_well:
            daemon.store.save()
    finally:
        daemon.source.close()
        daemon.store.close()


def all_sent(daemon: Daemon, client: Client) -> None:
    look_until_indexed(daemon.source, 1000 * SECOND_NS)
    client.hear()
    assert client.holds() == daemon.expected(client)
    assert client.mirror.complete == daemon.source.revision == daemon.map.core.revision


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 7, 100])
def test_tiles_that_come_and_go_between_looks_are_reported(tmp_path: Path, every: int) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        clients = [Client(daemon.source, interest) for interest in LEVELS]
        for ping in range(40):
            daemon.dive(ping, ping + 1)
            if ping % every == 0:
                daemon.look()
                for client in clients:
                    client.hear(2000, 3)
        assert daemon.store.counters.tiles_dropped > 3
        for client in clients:
            all_sent(daemon, client)


class Interrupted:
    """A map in which something happens just before it is asked something for the first time."""

    def __init__(self, core: _core.VoxelMap, what: str, happens: Callable[[], None]) -> None:
        self._core, self._what = core, what
        self._happens: Callable[[], None] | None = happens

    def __getattr__(self, name: str) -> object:
        if name == self._what and self._happens is not None:
            happens, self._happens = self._happens, None
            happens()
        return getattr(self._core, name)


@pytest.mark.slow
@pytest.mark.parametrize("saved", [False, True])
@pytest.mark.parametrize("asked", ["changed_blocks", "stream_digests", "stream_blocks"])
def test_tiles_that_leave_in_the_middle_are_reported(
    tmp_path: Path,
    asked: str,
    saved: bool,  # noqa: FBT001
) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client, late = Client(daemon.source), Client(daemon.source, LEVELS[2])
        daemon.dive(0, 9)
        if saved:
            daemon.store.save()
        core = Interrupted(daemon.map.core, asked, lambda: daemon.dive(35, 45))
        monkey = pytest.MonkeyPatch()
        monkey.setattr(daemon.source, "_core", core)
        monkey.setattr(daemon.source.encoder, "_core", core)
        daemon.look()
        for one in (client, late):
            one.hear()
        monkey.undo()
        assert daemon.store.counters.tiles_dropped > 2
        for one in (client, late):
            if one.mirror.complete == daemon.map.core.revision:
                assert one.holds() == daemon.expected(one)
            all_sent(daemon, one)
            resumed = Client(daemon.source, one.interest, one.resume())
            assert resumed.view.resumed
            assert not resumed.view.left


def test_what_left_memory_is_not_forgotten(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 10)
        daemon.look()
        client.hear()
        sent = set(client.holds())
        daemon.dive(35, 45)
        daemon.look()
        client.hear()
        assert sent <= set(client.holds())
        late = Client(daemon.source)
        late.hear()
        all_sent(daemon, late)
        assert late.holds() == client.holds()


def test_a_file_that_is_there_is_indexed_a_piece_a_look_nearest_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(source_module, "BRICKS_AT_ONCE", 3)
    with daemon_of(tmp_path / "dive.map") as daemon:
        daemon.dive(0, 40)
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.look((40.0, 2.0, -3.0))
        client.hear(position_m=(40.0, 2.0, -3.0))
        keys = client.mirror.blocks().keys
        assert len(keys)
        assert keys[:, 0].min() * 0.8 > 25.0
        assert client.mirror.complete is None
        assert client.view.left > 0
        looks = 1
        while daemon.source.indexing:
            daemon.look()
            looks += 1
        assert looks > 4
        all_sent(daemon, client)


def test_who_held_all_when_the_daemon_stopped_is_reported_changes_alone(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 20)
        all_sent(daemon, client)
    with daemon_of(tmp_path / "dive.map") as daemon:
        integrate(daemon.map, 20)
        daemon.store.advance(b"")
        sent = client.sent_blocks
        client.reconnect(daemon.source)
        assert (client.view.resumed, client.view.reason) == (True, "")
        all_sent(daemon, client)
        assert 0 < client.sent_blocks - sent < len(client.mirror) / 2
    with daemon_of(tmp_path / "dive.map") as daemon:
        sent = client.sent_blocks
        client.reconnect(daemon.source)
        all_sent(daemon, client)
        assert client.view.resumed
        assert client.sent_blocks == sent


def test_who_knows_what_was_never_saved_is_reported_all(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map", stops_well=False) as daemon:
        ahead, behind, between = (Client(daemon.source) for _ in range(3))
        daemon.dive(0, 11)  # saved up to ping 9
        daemon.store.save()
        daemon.look()
        for client in (ahead, behind, between):
            client.hear()
        integrate(daemon.map, 11)
        daemon.look()
        ahead.hear()
        between.hear(200, 1)  # it gets some of it, and not that this is all
    assert between.mirror.complete == behind.mirror.complete
    with daemon_of(tmp_path / "dive.map") as daemon:
        integrate(daemon.map, 12)  # that ping is gone: its revision means another map now
        daemon.store.advance(b"")
        for client, reason in ((ahead, "not_kept"), (behind, ""), (between, "not_kept")):
            client.reconnect(daemon.source)
            assert (client.view.resumed, client.view.reason) == (not reason, reason)
            all_sent(daemon, client)


def test_who_does_not_report_what_it_knows_of_another_session_is_reported_all(
    tmp_path: Path,
) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 3)
        all_sent(daemon, client)
        resume = client.resume()
    assert resume is not None
    with daemon_of(tmp_path / "dive.map") as daemon:
        silent = msgspec.structs.replace(resume, newest=None)
        assert daemon.source.subscribe(Interest(), silent).reason == "not_kept"
        assert daemon.source.subscribe(Interest(), resume).resumed


def test_a_reset_makes_another_map_for_good(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 10)
        all_sent(daemon, client)
        before, resume = daemon.source.info().id, client.resume()
        daemon.store.reset()
        daemon.dive(30, 32)
        all_sent(daemon, client)
        after = daemon.source.info().id
        assert (client.resets, after != before) == (1, True)
        assert daemon.source.subscribe(Interest(), resume).reason == "another_map"
    with daemon_of(tmp_path / "dive.map") as daemon:
        assert daemon.source.info().id == after
        client.reconnect(daemon.source)
        assert client.view.resumed


def test_sessions_are_remembered_for_a_while(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 2)
        all_sent(daemon, client)
        resume = client.resume()
    reasons = []
    for _ in range(17):
        with daemon_of(tmp_path / "dive.map") as daemon:
            reasons.append(daemon.source.subscribe(Interest(), resume).reason)
    assert reasons == [""] * 16 + ["unknown_session"]


def test_a_file_of_before_becomes_a_map_of_its_own(tmp_path: Path) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 2)
        all_sent(daemon, client)
        before = daemon.source.info().id
    for change in ("DELETE FROM fact", "UPDATE fact SET value = '{'"):
        with sqlite3.connect(tmp_path / "dive.map") as connection:
            connection.execute(f"{change} WHERE name = 'map.identity'")
        connection.close()
        with daemon_of(tmp_path / "dive.map") as daemon:
            assert daemon.source.info().id != before
            before = daemon.source.info().id
            client.reconnect(daemon.source)
            assert client.view.reason == "another_map"
            all_sent(daemon, client)


def test_after_damage_nobody_goes_on_from_before(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    with daemon_of(path) as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 20)
        all_sent(daemon, client)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    connection.close()
    with daemon_of(path) as daemon:
        assert daemon.store.check()
        client.reconnect(daemon.source)
        assert client.view.reason == "map_damaged"
        all_sent(daemon, client)


def test_clients_know_how_many_bricks_are_damaged(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    with daemon_of(path) as daemon:
        daemon.dive(0, 40)
        client = Client(daemon.source)
        all_sent(daemon, client)
        assert client.mirror.info.bricks_lost == 0
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    connection.close()
    with daemon_of(path) as daemon:  # nobody has verified the file, and no ping is near
        client = Client(daemon.source)
        look_until_indexed(daemon.source, SECOND_NS)
        client.hear()
        assert client.mirror.info.bricks_lost == 1
        daemon.store.settle_suspects()
        assert len(daemon.store.lost) == 1


def test_a_brick_that_came_back_is_reported_to_who_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    with daemon_of(path) as daemon:
        client = Client(daemon.source)
        daemon.dive(0, 20)
        all_sent(daemon, client)
        bricks = _bricks(path)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    connection.close()
    with daemon_of(path) as daemon:
        lost = daemon.store.check()
        client.reconnect(daemon.source)
        look_until_indexed(daemon.source, SECOND_NS)
        client.hear()
        assert client.mirror.complete == daemon.source.revision
    with daemon_of(path) as daemon:
        daemon.store.restore([(key, bricks[key]) for key in lost], whole=True)
        client.reconnect(daemon.source)
        assert client.view.resumed
        all_sent(daemon, client)


def _bricks(path: Path) -> dict[tuple[int, int, int], bytes]:
    whole = SonarMap(CONFIG)
    with StoreReader(path) as reader:
        reader.load(whole)
    return {key: brick for key, _, brick in whole.core.bricks_since(0)[1]}


def test_a_file_that_cannot_be_read_is_reported_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with daemon_of(tmp_path / "dive.map") as daemon:
        daemon.dive(0, 30)
        client = Client(daemon.source)
        calls = itertools.count()
        load = map_index.StoredBricks.load

        def broken(self: map_index.StoredBricks, bricks: NDArray[np.int32]) -> object:
            if next(calls) < 3:
                raise StoreError("the disk is gone", "io_error")
            return load(self, bricks)

        monkeypatch.setattr(map_index.StoredBricks, "load", broken)
        for _ in range(2):
            daemon.source.look(SECOND_NS)
            assert daemon.source.trouble == "the disk is gone"
            client.hear()
        assert client.mirror.complete is None
        daemon.source.look(SECOND_NS)
        while client.hear():
            pass
        all_sent(daemon, client)
