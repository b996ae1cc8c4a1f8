"""A full disk: the map stays in memory, the problem is reported, and nothing is lost."""

import os
import resource
import signal
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mapperd.errors import MapError, StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import OVERDRAFT, TileStore
from tests.mapperd.store import dive

NOBODY = 65534


def content(path: Path) -> tuple[bytes, int]:
    sonar_map = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        position = reader.load(sonar_map).position
    return sonar_map.core.encode_map(), int.from_bytes(position, "little")


def fill_disk(store: TileStore) -> None:
    connection = store._saver._connection
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {pages}")


def free_disk(store: TileStore) -> None:
    store._saver._connection.execute(f"PRAGMA max_page_count = {1 << 30}")


def step(sonar_map: SonarMap, store: TileStore, number: int) -> None:
    dive.integrate(sonar_map, number)
    store.advance(struct.pack("<Q", number + 1))


def test_full_disk_costs_memory_and_nothing_of_the_map(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path, cache_tiles=4)
    with store:
        dive.dive_on(sonar_map, store, 0, 19)
        fill_disk(store)
        for number in range(19, 40):
            step(sonar_map, store, number)
        with pytest.raises(StoreError) as refused:
            store.save()
        assert refused.value.reason == "disk_full"
        assert "full" in str(store.status()["reason"])
        assert store.status()["state"] == "stuck"
        assert store.counters.saves_failed > 1
        assert content(path) == (dive.mapped(19).core.encode_map(), 19)
        free_disk(store)
        for number in range(40, 60):
            step(sonar_map, store, number)
        store.save()
        assert store.trouble is None
    assert content(path) == (dive.mapped(60).core.encode_map(), 60)


def test_pings_are_refused_before_memory_runs_out(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path, cache_tiles=1)
    store.save()
    fill_disk(store)
    number = 0
    with pytest.raises(MapError) as refused:  # noqa: PT012 the first that is too many
        for number in range(200):
            step(sonar_map, store, number)
    assert refused.value.reason == "store_stuck"
    assert OVERDRAFT <= len(store._tiles) <= OVERDRAFT + 8
    before = sonar_map.core.encode_map()
    with pytest.raises(MapError):
        dive.integrate(sonar_map, number)
    assert sonar_map.core.encode_map() == before
    free_disk(store)
    with store:
        for later in range(number, 80):
            step(sonar_map, store, later)
    assert content(path) == (dive.mapped(80).core.encode_map(), 80)


def test_a_limit_of_the_system_is_met_like_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = dive.open_store(path)
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        dive.dive_on(sonar_map, store, 0, 10)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, unlimited[1]))
        step(sonar_map, store, 10)
        with pytest.raises(StoreError) as refused:  # noqa: PT012 the first that is too many
            for number in range(11, 60):
                step(sonar_map, store, number)
                store.save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
        signal.signal(signal.SIGXFSZ, ignored)
    assert refused.value.reason in ("disk_full", "io_error")
    with store:
        noted = store._noted[1]
        assert isinstance(noted, bytes)
        (pings,) = struct.unpack("<Q", noted)
        dive.dive_on(sonar_map, store, pings, 60)
    assert content(path) == (dive.mapped(60).core.encode_map(), 60)


@contextmanager
def without_privilege() -> Iterator[None]:
    """Root may write anywhere; nobody may not."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.parametrize("left_behind", [True, False])
def test_a_folder_that_cannot_be_written_to_can_be_read_and_is_not_mapped_into(
    *, left_behind: bool
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dive.map"
        sonar_map, store = dive.open_store(path)
        with store:
            dive.dive_on(sonar_map, store, 0, 20)
        whole = content(path)
        path.with_name("dive.map.lock").unlink()
        for suffix in () if left_behind else ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        path.parent.chmod(0o555)
        with without_privilege():
            assert content(path) == whole
            with pytest.raises(StoreError) as refused:
                dive.open_store(path)
        path.parent.chmod(0o700)
    assert whole[1] == 20
    assert refused.value.reason == "read_only"
