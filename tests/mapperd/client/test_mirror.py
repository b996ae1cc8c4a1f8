"""The mirror against a plain dictionary of blocks, and what it makes of its cells."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.client import Interest, MapInfo, MapMirror
from mapperd.config.tree import Config
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import BLOCK_EDGE
from tests.support.stream_server import MAP_INFO, a_block

KEYS = st.tuples(*[st.integers(-2, 2)] * 3)
ROUNDS = st.lists(st.dictionaries(KEYS, st.integers(-1, 5), max_size=6), max_size=20)
"""Blocks by key: the number of their cells, -1 for nothing known."""


def block_set(sent: dict[tuple[int, int, int], int], *, counts: bool = False) -> BlockSet:
    cells = np.array(
        [a_block(n) if n >= 0 else np.full(CELLS, UNKNOWN) for n in sent.values()], np.int8
    ).reshape(-1, CELLS)
    keys = np.array(list(sent), np.int32).reshape(-1, 3)
    seen = np.where(cells == UNKNOWN, 0, 3).astype(np.uint8) if counts else None
    return BlockSet(keys, np.zeros(len(sent), np.uint32), cells, seen)


@given(rounds=ROUNDS, counts=st.booleans())
@settings(max_examples=50, deadline=None)
def test_mirror_holds_the_newest_of_every_block(
    rounds: list[dict[tuple[int, int, int], int]],
    *,
    counts: bool,
) -> None:
    mirror = MapMirror(MAP_INFO, Interest(detail="counts" if counts else "log_odds"))
    held: dict[tuple[int, int, int], int] = {}
    for sent in rounds:
        mirror.put(block_set(sent, counts=counts), 0)
        held = {key: number for key, number in (held | sent).items() if number >= 0}
    assert len(mirror) == len(held)
    blocks = mirror.blocks()
    found = dict(zip(map(tuple, blocks.keys.tolist()), blocks.cells, strict=True))
    assert found.keys() == held.keys()
    assert all((found[key] == a_block(number)).all() for key, number in held.items())
    again = MapMirror(MAP_INFO, mirror.interest)
    again.put(block_set(dict(sorted(held.items())), counts=counts), 7)
    assert again.digest() == mirror.digest()


def test_rows_are_used_again() -> None:
    mirror = MapMirror(MAP_INFO, Interest())
    for round_ in range(2000):
        mirror.put(block_set({(round_, 0, 0): 1, (round_ - 5, 0, 0): -1}), 0)
    assert len(mirror) == 5
    assert len(mirror._table.keys) == 256


def corner(key: tuple[int, int, int], cell: tuple[int, int, int], level: int) -> list[float]:
    """Centre of a cell, by the document."""
    edge = 2**level * MAP_INFO.resolution_m
    return [(BLOCK_EDGE * k + c + 0.5) * edge for k, c in zip(key, cell, strict=True)]


@pytest.mark.parametrize("level", [0, 2])
def test_cells_are_where_and_what_they_are(level: int) -> None:
    mirror = MapMirror(MAP_INFO, Interest(level=level, detail="counts"))
    cells = np.full((1, CELLS), UNKNOWN, np.int8)
    cells[0, 3 + 8 * 1 + 64 * 6] = 12  # 3.0: occupied
    cells[0, 0] = -6  # -1.5: free
    cells[0, 511] = 0  # neither
    counts = np.zeros((1, CELLS), np.uint8)
    counts[0, 3 + 8 * 1 + 64 * 6] = 4
    blocks = BlockSet(np.array([[-1, 0, 2]], np.int32), np.array([1500], np.uint32), cells, counts)
    mirror.put(blocks, 10**18)
    occupied, free = mirror.cells(), mirror.cells("free")
    place = corner((-1, 0, 2), (3, 1, 6), level)
    assert occupied.centres_m.tolist() == [pytest.approx(place)]
    assert free.centres_m.tolist() == [pytest.approx(corner((-1, 0, 2), (0, 0, 0), level))]
    assert occupied.log_odds.tolist() == [3.0]
    assert occupied.probability[0] == pytest.approx(1 / (1 + np.exp(-3.0)))
    assert occupied.count.tolist() == [8]
    assert occupied.changed_ns.tolist() == [10**18 - 1_500_000_000]
    assert len(mirror.cells("known")) == 3
    assert len(mirror.cells(min_probability=0.5)) == 2
    assert len(mirror.cells(keys=[[0, 0, 0]])) == 0
    end = corner((-1, 0, 2), (7, 7, 7), level)
    points = [*occupied.centres_m, *free.centres_m, end, [50.0, 0, 0]]
    assert mirror.classify(points).tolist() == [1, 0, -1, -1]


def test_a_cell_at_a_threshold_is_of_neither_class() -> None:
    mirror = MapMirror(MapInfo("m", 0.1, 0.25, 0.5, -0.5), Interest())
    cells = np.full((1, CELLS), UNKNOWN, np.int8)
    cells[0, :4] = [-3, -2, 2, 3]
    mirror.put(BlockSet(np.zeros((1, 3), np.int32), np.zeros(1, np.uint32), cells), 0)
    assert mirror.cells().log_odds.tolist() == [0.75]
    assert mirror.cells("free").log_odds.tolist() == [-0.75]


def test_certainty_has_no_log_odds_and_is_asked_for_all_the_same() -> None:
    mirror = MapMirror(MAP_INFO, Interest())
    mirror.put(block_set({(0, 0, 0): 1}), 0)
    assert len(mirror.cells(min_probability=1.0)) == 0
    assert len(mirror.cells(min_probability=0.0)) == len(mirror.cells("known"))


def test_ages_of_weeks_do_not_wrap() -> None:
    mirror = MapMirror(MAP_INFO, Interest())
    blocks = block_set({(0, 0, 0): 1})
    blocks.ages_ms[:] = 2**32 - 1
    mirror.put(blocks, 10**18)
    changed_ns = mirror.cells("known").changed_ns
    assert set(changed_ns.tolist()) == {10**18 - (2**32 - 1) * 10**6}


def test_classes_have_values_that_are_of_their_class() -> None:
    mirror = MapMirror(MAP_INFO, Interest(detail="classes"))
    cells = np.full((1, CELLS), UNKNOWN, np.int8)
    cells[0, :3] = [-1, 0, 1]
    mirror.put(BlockSet(np.zeros((1, 3), np.int32), np.zeros(1, np.uint32), cells), 0)
    known = mirror.cells("known")
    assert known.log_odds[0] < MAP_INFO.free_log_odds
    assert MAP_INFO.free_log_odds < known.log_odds[1] < MAP_INFO.occupied_log_odds
    assert known.log_odds[2] > MAP_INFO.occupied_log_odds
    assert [len(mirror.cells(kind)) for kind in ("occupied", "free")] == [1, 1]


def test_map_of_a_mirror_has_its_cells() -> None:
    facts = MapInfo("m", 0.1, 0.5, 0.6, -1.4)
    mirror = MapMirror(facts, Interest(level=1))
    mirror.put(block_set({(0, 0, 0): 1, (-2, 1, 0): 2}), 0)
    sonar_map = mirror.to_map(Config())
    assert sonar_map.resolution_m == pytest.approx(0.2)
    counts = sonar_map.counts()
    assert counts.occupied == len(mirror.cells())
    assert counts.free == len(mirror.cells("free"))
    assert counts.occupied + counts.free + counts.uncertain == len(mirror.cells("known"))
    voxels, cells = sonar_map.voxels("occupied"), mirror.cells()
    by_place = np.lexsort(cells.centres_m.round(6).T)
    again = np.lexsort(voxels.centres_m.round(6).T)
    np.testing.assert_allclose(voxels.centres_m[again], cells.centres_m[by_place])
    np.testing.assert_allclose(voxels.probability[again], cells.probability[by_place], atol=1e-6)


def test_points_beyond_the_reach_are_unknown() -> None:
    mirror = MapMirror(MAP_INFO, Interest())
    mirror.put(block_set({(0, 0, 0): 1}), 0)
    far = 2.0**35 * MAP_INFO.resolution_m  # a key of this wraps around to 0
    points = [[far, 0.05, 0.05], [np.inf, 0.05, 0.05], [np.nan, 0.05, 0.05]]
    assert mirror.classify(points).tolist() == [-1, -1, -1]
