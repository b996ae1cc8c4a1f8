"""The order of all pings of a survey, and which tile wants which of them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapper_survey.spool import Rows
from mapperd.mapping.sonar_map import BLOCK_VOXELS, BRICK_VOXELS

__all__ = ["PLACE", "Key", "Tile", "children_of", "ordinals_of", "tiles_of"]

Key = tuple[int, int, int]

PLACE = np.dtype([("ordinal", "<i8"), ("dive", "<i4"), ("size", "<i4"), ("offset", "<i8")])
"""Of a ping: its number in the survey, from 1, and where its record is."""

BLOCKS = BRICK_VOXELS // BLOCK_VOXELS
"""Along a brick's edge."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A cube of bricks: `key` in units of its edge, `edge` in bricks."""

    key: Key
    edge: int

    @property
    def name(self) -> str:
        """Its own among all tiles."""
        return f"{self.key[0]}_{self.key[1]}_{self.key[2]}_{self.edge}"

    def children(self) -> list["Tile"]:
        """The eight of half its edge; none of a single brick, or of an odd number of them."""
        if self.edge % 2:
            return []
        steps = itertools.product((0, 1), repeat=3)
        x, y, z = self.key
        return [Tile((2 * x + i, 2 * y + j, 2 * z + k), self.edge // 2) for i, j, k in steps]


def ordinals_of(dives: Sequence[Rows]) -> list[NDArray[np.int64]]:
    """Number all pings by time, from 1.

    Within a dive they stay in the order in which they came, whatever its clock did; a ping without
    a time goes with the one before it. At the same time the dive that is named first goes first.
    """
    times = [np.maximum.accumulate(rows["t_ns"]) if len(rows) else rows["t_ns"] for rows in dives]
    together = np.concatenate(times)
    order = np.argsort(together, kind="stable")
    ordinals = np.empty(len(together), dtype=np.int64)
    ordinals[order] = np.arange(1, len(together) + 1)
    return np.split(ordinals, np.cumsum([len(each) for each in times])[:-1])


def tiles_of(
    dives: Sequence[Rows], ordinals: Sequence[NDArray[np.int64]], edge: int
) -> dict[Tile, NDArray[np.void]]:
    """The pings whose boxes touch each tile, in order.

    Args:
        dives: rows of each.
        ordinals: of their pings.
        edge: of a tile, in bricks.
    """
    parts: dict[Tile, list[NDArray[np.void]]] = {}
    for dive, (rows, numbers) in enumerate(zip(dives, ordinals, strict=True)):
        places = np.zeros(len(rows), dtype=PLACE)
        places["ordinal"], places["dive"] = numbers, dive
        places["size"], places["offset"] = rows["size"], rows["offset"]
        for key, chosen in _touched(rows, edge).items():
            parts.setdefault(Tile(key, edge), []).append(places[chosen])
    merged = {tile: np.concatenate(found) for tile, found in sorted(parts.items(), key=_key)}
    return {tile: found[np.argsort(found["ordinal"])] for tile, found in merged.items()}


def children_of(
    tile: Tile,
    places: NDArray[np.void],
    dives: Sequence[Rows],
    ordinals: Sequence[NDArray[np.int64]],
) -> dict[Tile, NDArray[np.void]]:
    """What `tiles_of` half its edge says of a tile's children, from the tile's own pings alone.

    Args:
        tile: to be cut.
        places: its pings.
        dives: rows of each.
        ordinals: of their pings.
    """
    first = np.empty((len(places), 3), dtype=np.int32)
    last = np.empty((len(places), 3), dtype=np.int32)
    for dive in np.unique(places["dive"]):
        of_dive = places["dive"] == dive
        # Within a dive numbers ascend.
        at = np.searchsorted(ordinals[dive], places["ordinal"][of_dive])
        first[of_dive], last[of_dive] = dives[dive]["first"][at], dives[dive]["last"][at]
    found = {}
    for child in tile.children():
        low = np.array(child.key) * (child.edge * BLOCKS)
        high = low + (child.edge * BLOCKS - 1)
        touches = np.all((first <= high) & (last >= low), axis=1)
        if touches.any():
            found[child] = places[touches]
    return found


def _key(item: tuple[Tile, object]) -> Key:
    return item[0].key


def _touched(rows: Rows, edge: int) -> dict[Key, NDArray[np.int64]]:
    """Numbers of the pings that touch each tile."""
    said = np.flatnonzero(np.all(rows["first"] <= rows["last"], axis=1))
    if not len(said):
        return {}
    first = rows["first"][said] // (edge * BLOCKS)
    last = rows["last"][said] // (edge * BLOCKS)
    spans = (last - first).max(axis=0) + 1
    keys, numbers = [], []
    for step in itertools.product(*(range(int(span)) for span in spans)):
        at = first + np.array(step, dtype=np.int32)
        inside = np.all(at <= last, axis=1)
        keys.append(at[inside])
        numbers.append(said[inside])
    return _grouped(np.concatenate(keys), np.concatenate(numbers))


def _grouped(keys: NDArray[np.int32], numbers: NDArray[np.int64]) -> dict[Key, NDArray[np.int64]]:
    order = np.lexsort((numbers, keys[:, 2], keys[:, 1], keys[:, 0]))
    keys, numbers = keys[order], numbers[order]
    cuts = np.flatnonzero(np.any(np.diff(keys, axis=0) != 0, axis=1)) + 1
    groups = zip(keys[np.r_[0, cuts]], np.split(numbers, cuts), strict=True)
    return {(int(key[0]), int(key[1]), int(key[2])): group for key, group in groups}
