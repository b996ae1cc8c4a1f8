"""Which tile wants which pings."""

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest
from mapper_survey.spool import NO_BOX, ROW, Rows
from mapper_survey.tiles import BLOCKS, PLACE, Tile, children_of, ordinals_of, tiles_of


def random_rows(seed: int, count: int) -> Rows:
    """Pings back and forth, some without evidence, and one large one."""
    random = np.random.default_rng(seed)
    rows = np.zeros(count, dtype=ROW)
    rows["t_ns"] = np.sort(random.integers(0, 10**6, count))
    rows["size"] = random.integers(100, 200, count)
    rows["offset"] = np.cumsum(rows["size"])
    rows["first"] = np.round(200 * np.sin(np.arange(count)[:, None] * (0.01, 0.013, 0.02)))
    rows["last"] = rows["first"] + random.integers(0, 12, (count, 3))
    rows["last"][count // 2] += 30
    silent = random.random(count) < 0.1
    rows["first"][silent], rows["last"][silent] = NO_BOX
    return rows


@pytest.mark.slow
def test_children_have_the_pings_that_they_would_have_alone() -> None:
    dives = [random_rows(1, 700), random_rows(2, 500)]
    ordinals = ordinals_of(dives)
    for edge in (16, 4, 2):
        fine = tiles_of(dives, ordinals, edge // 2)
        cut: dict[Tile, Any] = {}
        for tile, places in tiles_of(dives, ordinals, edge).items():
            cut |= children_of(tile, places, dives, ordinals)
        assert cut.keys() == fine.keys()
        assert len(cut) > 8
        assert all(cut[tile].tobytes() == fine[tile].tobytes() for tile in fine)


def test_a_single_brick_has_no_children() -> None:
    dives = [random_rows(3, 50)]
    ordinals = ordinals_of(dives)
    tile, places = next(iter(tiles_of(dives, ordinals, 1).items()))
    assert children_of(tile, places, dives, ordinals) == {}


def pings_in_a_row(count: int) -> Rows:
    """A long line, two blocks from ping to ping, each ping 20 blocks wide."""
    rows = np.zeros(count, dtype=ROW)
    rows["t_ns"] = np.arange(count)
    rows["first"][:, 0] = 2 * np.arange(count)
    rows["last"] = rows["first"] + 19
    return rows


@pytest.mark.parametrize("count", [2_000, 200_000])
def test_cutting_one_tile_looks_at_its_own_pings_alone(count: int) -> None:
    dives = [pings_in_a_row(count)]
    ordinals = ordinals_of(dives)
    edge = 32
    length = edge * BLOCKS
    mine = np.flatnonzero(
        (dives[0]["first"][:, 0] < 2 * length) & (dives[0]["last"][:, 0] >= length)
    )
    places = np.zeros(len(mine), dtype=PLACE)
    places["ordinal"] = ordinals[0][mine]
    assert 60 < len(places) < 100
    tracemalloc.start()
    try:
        children = children_of(Tile((1, 0, 0), edge), places, dives, ordinals)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert [tile.key for tile in children] == [(2, 0, 0), (3, 0, 0)]
    kept = sum(found.nbytes for found in children.values())
    assert kept < 2 * places.nbytes
    assert most < 20_000  # the rows of all take 88 kB, and 8.8 MB


def test_children_lie_side_by_side_in_their_tile() -> None:
    children = Tile((-3, 0, 5), 2).children()
    corners = {tuple(np.array(child.key) - (-6, 0, 10)) for child in children}
    assert corners == set(itertools.product((0, 1), repeat=3))
    assert {child.edge for child in children} == {1}
