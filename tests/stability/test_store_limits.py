"""Hard cases of the map's file: numbers at their ends, borders of tiles, and torn files."""

from __future__ import annotations

import dataclasses
import itertools
import shutil
import sqlite3
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard

from mapperd import _core
from mapperd.config.tree import Config, IwloConfig, OctreeConfig
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.metadata import write_checksum
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore, tile_bricks
from mapperd.store.tiles import MAX_BYTES, DamagedBrickError, pack, unpack

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

WIDE = Config(
    octree=OctreeConfig(voxel_resolution=0.1),
    iwlo=IwloConfig(L_min=-127.0, L_max=127.0, decay_rate=1.0, min_alpha=1 / 65536),
)
BRICK_M = 0.1 * _core.BRICK_VOXELS
BLOCKS = (_core.BRICK_VOXELS // _core.BLOCK_EDGE) ** 3
"""Of a brick."""

VOXELS = _core.BLOCK_EDGE**3
"""Of a block."""

UNIT = 2.0**-8
"""In which a map with these clamps holds log-odds."""

LAST_BLOCK = 2**30
"""Of the map's reach, along each axis."""


def voxels_at(points: NDArray[np.float64], log_odds: NDArray[np.float64]) -> SonarMap:
    sonar_map = SonarMap(WIDE)
    sonar_map.core.set_log_odds(points, log_odds)
    return sonar_map


def save(path: Path, sonar_map: SonarMap, tile_size_m: float = BRICK_M) -> None:
    """Put a map that is in memory into a new file."""
    bricks = [(key, brick) for key, _, brick in sonar_map.core.bricks_since(0)[1]]
    target = SonarMap(WIDE)
    target.core.raise_revision(sonar_map.core.revision)
    with TileStore(path, target, tile_size_m=tile_size_m, cache_tiles=1) as store:
        store.restore(bricks, whole=True)


def loaded(path: Path) -> SonarMap:
    sonar_map = SonarMap(WIDE)
    with StoreReader(path) as reader:
        reader.load(sonar_map)
    return sonar_map


def test_the_surest_and_the_most_seen_voxels_come_back_to_the_bit(tmp_path: Path) -> None:
    """The file holds log-odds of +-127 and counts of 65535, the ends of what a voxel can be.

    Naively they are written as floats of 32 bits or bytes, and the map that goes on from the file
    differs from the one that was never stopped.
    """
    values = np.array([127.0, -127.0, UNIT, -UNIT, 0.0, 127.0 - UNIT])
    points = np.zeros((6, 3)) + 0.05
    points[:, 0] += 3.2 * np.arange(6)
    sonar_map = voxels_at(points, values)
    assert sonar_map.core.query(points)[0].tolist() == values.tolist()
    often = np.repeat(points[:1], 66_000, axis=0)
    sonar_map.core.observe(often, np.full(66_000, 255.0), np.ones(66_000, bool))
    assert sonar_map.core.voxels()[2].max() == 65535
    save(tmp_path / "a.map", sonar_map)
    assert loaded(tmp_path / "a.map").core.encode_map() == sonar_map.core.encode_map()


@pytest.mark.parametrize("bricks", [1, 3])
def test_voxels_on_both_sides_of_each_border_of_tiles_stay_in_their_tile(
    tmp_path: Path, bricks: int
) -> None:
    """Tiles are cubes of bricks, counted from the origin to both sides.

    Naively a brick's index is divided towards zero: the tiles beside the origin share bricks, and
    what one of them saves the other one overwrites.
    """
    edge_m = bricks * BRICK_M
    at = [side * edge_m + off for side in (-2, -1, 0, 1, 2) for off in (-0.05, 0.05)]
    points = np.array(list(itertools.product(at, at[2:8], at[4:6])))
    values = np.round(np.linspace(-100, 100, len(points)) / UNIT) * UNIT
    expected = voxels_at(points, values)
    path = tmp_path / "a.map"
    save(path, expected, edge_m)
    tiles = np.floor(points / edge_m).astype(int)
    sonar_map = SonarMap(WIDE)
    with TileStore(path, sonar_map, tile_size_m=edge_m, cache_tiles=1000) as store:
        for tile in map(tuple, np.unique(tiles, axis=0).tolist()):
            before = sonar_map.core.query(points)[0]
            store._fetch([tile])
            got = sonar_map.core.query(points)[0]
            inside = (tiles == tile).all(axis=1)
            assert (got[inside] == values[inside]).all()
            assert (got[~inside] == before[~inside]).all()
    assert loaded(path).core.encode_map() == expected.core.encode_map()


def test_voxels_at_the_end_of_the_map_s_reach_are_stored(tmp_path: Path) -> None:
    """The reach is 2**30 blocks, 1.7 million kilometres of 10 cm: keys of 31 bits, in both signs.

    Naively the keys of a tile's bricks overflow, or are cut to 32 bits unsigned in the table: what
    was mapped there cannot be found again.
    """
    last_m = (LAST_BLOCK * _core.BLOCK_EDGE - 20) * 0.1
    points = np.array([[last_m, 0.0, -last_m], [-last_m, last_m, last_m]])
    expected = voxels_at(points, np.array([3.0, -3.0]))
    for name, tile_size_m in (("a.map", BRICK_M), ("b.map", 7 * BRICK_M)):
        save(tmp_path / name, expected, tile_size_m)
        got = loaded(tmp_path / name).core
        assert got.query(points)[0].tolist() == [3.0, -3.0]
        assert got.encode_map() == expected.core.encode_map()


def test_a_brick_of_noise_is_no_larger_than_a_row_may_be(tmp_path: Path) -> None:
    """A brick whose voxels all differ from their neighbours does not become smaller by packing.

    Naively the limit on what is read is a guess at how well maps can be packed: a map of noise is
    written, and called damaged when it is read.
    """
    edge = _core.BRICK_VOXELS
    points = np.ascontiguousarray(np.indices((edge,) * 3).reshape(3, -1).T + 0.5) * 0.1
    noise = np.random.default_rng(6).uniform(-127, 127, len(points))
    sonar_map = voxels_at(points, noise)
    ((_, _, brick),) = sonar_map.core.bricks_since(0)[1]
    # Form 5 of each block: place, revision, form, shift, two sets of cells; units and counts.
    assert len(brick) == 1 + BLOCKS * (1 + 8 + 1 + 1 + 8 + 8 + VOXELS * (2 + 2)) < MAX_BYTES
    save(tmp_path / "a.map", sonar_map)
    assert loaded(tmp_path / "a.map").core.encode_map() == sonar_map.core.encode_map()


def test_a_brick_of_noise_of_an_older_version_is_as_large_as_a_row_may_be(tmp_path: Path) -> None:
    """Files of older versions hold voxels one by one, in six bytes each and not in four.

    Naively the limit goes down with what is written today: the fullest rows of an older file are
    called damaged.
    """
    rng = np.random.default_rng(7)
    units = rng.integers(-127 * 2**8, 127 * 2**8, (BLOCKS, VOXELS)).astype("<i4")
    counts = rng.integers(1, 65535, (BLOCKS, VOXELS), endpoint=True).astype("<u2")
    old = bytes([BLOCKS])
    for place in range(BLOCKS):
        head = struct.pack("<BQB", place, 1, 2) + b"\xff" * (VOXELS // 8)
        old += head + (units[place] * 2**16).tobytes() + counts[place].tobytes()
    assert len(old) == MAX_BYTES
    row = pack(zstandard.ZstdCompressor(), (0, 0, 0), 1, old)
    assert unpack(zstandard.ZstdDecompressor(), row) == old
    expected = SonarMap(WIDE)
    expected.core.put_bricks([((0, 0, 0), old)])
    _, got_units, got_counts = expected.core.blocks()
    assert np.array_equal(np.sort(got_units.ravel()), np.sort(units.ravel() * 2**16))
    assert np.array_equal(np.sort(got_counts.ravel()), np.sort(counts.ravel()))
    target = SonarMap(WIDE)
    with TileStore(tmp_path / "a.map", target, tile_size_m=BRICK_M, cache_tiles=1) as store:
        store.restore([((0, 0, 0), old)], whole=True)
    assert loaded(tmp_path / "a.map").core.encode_map() == expected.core.encode_map()


def test_a_row_in_the_place_of_its_mirror_image_is_damaged() -> None:
    """A checksum is of the key as well, for a good row in a wrong place is a wall in free water.

    Naively it is of the data alone, or of the key without its sign.
    """
    packer, unpacker = zstandard.ZstdCompressor(), zstandard.ZstdDecompressor()
    row = pack(packer, (5, -7, 2**28), 9, b"brick")
    assert unpack(unpacker, row) == b"brick"
    moved = [(-5, -7, 2**28), (5, 7, 2**28), (5, -7, -(2**28)), (5 + 2**32, -7, 2**28)]
    for key in moved:
        with pytest.raises(DamagedBrickError, match="checksum"):
            unpack(unpacker, dataclasses.replace(row, key=key))


@pytest.mark.parametrize("revision", [2**53, 2**61])
def test_a_map_of_more_changes_than_a_double_counts_goes_on(tmp_path: Path, revision: int) -> None:
    """What changed since the last save is known by revisions, which count for the map's life.

    Naively a revision passes through a double and is rounded: bricks that changed once after the
    save are taken for saved.
    """
    path = tmp_path / "a.map"
    save(path, voxels_at(np.full((1, 3), 0.05), np.ones(1)))
    change(path, "UPDATE progress SET revision = ?", revision)
    seal(path)
    for number in range(3):
        sonar_map = SonarMap(WIDE)
        with TileStore(path, sonar_map, tile_size_m=BRICK_M, cache_tiles=1) as store:
            assert sonar_map.core.revision == revision + number
            store._fetch([(0, 0, 0)])
            sonar_map.core.set_log_odds(np.full((1, 3), 0.05), np.array([number + 2.0]))
            store.advance(b"here")
        assert loaded(path).core.query(np.full((1, 3), 0.05))[0] == number + 2.0


@pytest.mark.parametrize("revision", [-1, -(2**63), 2**62, 2**63 - 1])
def test_a_revision_that_no_map_has_is_damage_and_reported(tmp_path: Path, revision: int) -> None:
    """One bit of a file may turn, and the sign of the revision is one.

    Naively the number is handed on as it is: opening ends in a TypeError, or the next save in an
    overflow.
    """
    path = tmp_path / "a.map"
    save(path, voxels_at(np.full((1, 3), 0.05), np.ones(1)))
    change(path, "UPDATE progress SET revision = ?", revision)
    seal(path)
    with pytest.raises(StoreError, match="revision") as caught:
        TileStore(path, SonarMap(WIDE), tile_size_m=BRICK_M, cache_tiles=1)
    assert caught.value.reason == "damaged"
    with pytest.raises(StoreError, match="revision"):
        loaded(path)


def test_a_journal_torn_at_any_byte_gives_a_state_that_was_saved(tmp_path: Path) -> None:
    """Power fails while the journal is written: its end is missing, or is of an older journal.

    Naively as many bricks of the last save are there as had been written, with the position of the
    one before or after: pings are mapped twice, or never.
    """
    path, torn = tmp_path / "a.map", tmp_path / "torn.map"
    states = [SonarMap(WIDE).core.encode_map()]
    sonar_map = SonarMap(WIDE)
    here = np.full((1, 3), 0.05)
    store = TileStore(path, sonar_map, tile_size_m=BRICK_M, cache_tiles=1)
    store._fetch([(0, 0, 0)])
    for number in range(3):
        points = here + np.arange(3)[:, None] * [0.1 * number + 0.1, 0.2, 0.0]
        sonar_map.core.set_log_odds(points, np.full(3, number + 1.0))
        store.advance(bytes([number + 1]))
        store.save()
        states.append(sonar_map.core.encode_map())
    journal = path.with_name("a.map-wal").read_bytes()
    shutil.copy(path, tmp_path / "copy.map")
    store.close()
    seen = set()
    for part in np.linspace(0.0, 1.0, 14):
        for left in tmp_path.glob("torn.map*"):
            left.unlink()
        shutil.copy(tmp_path / "copy.map", torn)
        size = round(len(journal) * part)
        torn.with_name("torn.map-wal").write_bytes(journal[:size] + b"\x55" * 100)
        seen.add(state_of(torn, states))
    assert {1, 2, 3} <= seen


def state_of(path: Path, states: list[bytes]) -> int:
    """Return the index of the file's state; -1 if it is refused as no map."""
    sonar_map = SonarMap(WIDE)
    try:
        with StoreReader(path) as reader:
            position = reader.load(sonar_map).position
    except StoreError:
        return -1
    assert sonar_map.core.encode_map() == states[position[0] if position else 0]
    return position[0] if position else 0


def test_tiles_of_any_size_are_whole_bricks() -> None:
    """The size of a tile is asked for in metres, from less than a voxel to more than the Earth.

    Naively the quotient is rounded to no brick at all, and every tile is the same.
    """
    for tile_size_m in (1e-9, 0.04, 6.4, 1e12):
        for resolution_m in (1e-4, 0.05, 1e4):
            edge = tile_bricks(tile_size_m, resolution_m)
            exact = tile_size_m / (_core.BRICK_VOXELS * resolution_m)
            assert edge >= 1
            assert abs(edge - exact) <= 0.5 or edge == 1


def change(path: Path, statement: str, *values: int) -> None:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute(statement, values)
    connection.close()


def seal(path: Path) -> None:
    """Write the checksum of a file whose revision was changed by hand."""
    with closing(sqlite3.connect(path)) as connection, connection:
        write_checksum(connection)
