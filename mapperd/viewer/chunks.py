"""Chunks of the map for the browser, nearest first, and their visible cells."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.client.mirror import MapMirror
from mapperd.wire.messages import BLOCK_EDGE

__all__ = [
    "FIRST_SPAN",
    "Chunk",
    "ChunkSurface",
    "Chunks",
    "Filter",
    "coarser",
    "drawn_of",
    "faces_shown",
    "points_m",
]

FIRST_SPAN = 4
"""Initial blocks along the edge of a chunk: 32 cells."""

LAST_SPAN = 32
"""Maximum, 256 cells: offsets of half a cell within a chunk are exact in half precision."""

Chunk = tuple[int, int, int]


class Chunks:
    """The chunks of the map, and which of them need drawing.

    Their edge doubles if too many are visible, because each costs the browser time.

    Args:
        max_chunks: maximum number of visible chunks.

    Attributes:
        span: blocks along the edge of a chunk.
    """

    def __init__(self, max_chunks: int) -> None:
        self.span = FIRST_SPAN
        self._max_chunks = max_chunks
        self._known: set[Chunk] = set()
        self._stale: set[Chunk] = set()
        self._shown: set[Chunk] = set()

    @property
    def edge(self) -> int:
        """Cells along the edge of a chunk."""
        return self.span * BLOCK_EDGE

    @property
    def stale(self) -> int:
        """Number of chunks to draw."""
        return len(self._stale)

    @property
    def shown(self) -> frozenset[Chunk]:
        """Visible chunks."""
        return frozenset(self._shown)

    @property
    def crowded(self) -> bool:
        """Whether too many chunks are visible, so that they should `grow`."""
        return len(self._shown) > self._max_chunks and self.span < LAST_SPAN

    def touch(self, keys: ArrayLike) -> None:
        """Mark blocks (N, 3) as changed, and with them the faces of their neighbours."""
        blocks = np.asarray(keys, np.int64).reshape(-1, 3)
        changed = self._chunks_of(blocks)
        self._known |= changed
        self._stale |= changed
        for axis in range(3):  # a cell shows the faces that its neighbours do not hide
            for step in (-1, 1):
                beside = blocks.copy()
                beside[:, axis] += step
                self._stale |= self._chunks_of(beside) & self._known

    def grow(self) -> None:
        """Double the size of chunks; everything must be drawn again."""
        self.span *= 2
        self._known = {(x // 2, y // 2, z // 2) for x, y, z in self._known}
        self._stale = set(self._known)
        self._shown.clear()

    def shows(self, chunk: Chunk, *, something: bool) -> None:
        """Set whether a drawn chunk is visible."""
        (self._shown.add if something else self._shown.discard)(chunk)

    def touch_all(self) -> None:
        """Draw all chunks again."""
        self._stale = set(self._known)

    def touch_some(self, chunks: Iterable[Chunk]) -> None:
        """Draw these chunks again."""
        self._stale |= self._known.intersection(chunks)

    def forget(self) -> None:
        """Remove all chunks."""
        self._known.clear()
        self._stale.clear()
        self._shown.clear()
        self.span = FIRST_SPAN

    def take(self, near_m: ArrayLike, cell_m: float, max_chunks: int) -> list[Chunk]:
        """Return the chunks to draw next, nearest first, and mark them as drawn."""
        if not self._stale:
            return []
        waiting = np.array(sorted(self._stale), np.int64)
        centres_m = (waiting + 0.5) * (self.edge * cell_m)
        order = np.argsort(np.linalg.norm(centres_m - np.asarray(near_m), axis=1), kind="stable")
        taken = [(int(x), int(y), int(z)) for x, y, z in waiting[order[:max_chunks]]]
        self._stale.difference_update(taken)
        return taken

    def blocks_of(self, chunk: Chunk) -> NDArray[np.int32]:
        """Keys of the blocks of a chunk and of the blocks around it, (M, 3)."""
        return _cube(self.span + 2) + np.asarray(chunk, np.int32) * self.span - 1

    def _chunks_of(self, blocks: NDArray[np.int64]) -> set[Chunk]:
        return set(map(tuple, np.unique(blocks // self.span, axis=0).tolist()))


def _cube(edge: int) -> NDArray[np.int32]:
    sides: NDArray[np.int32] = np.indices((edge,) * 3, np.int32)
    return np.ascontiguousarray(sides.reshape(3, -1).T)


@dataclass(frozen=True, slots=True)
class Filter:
    """Which cells are drawn.

    Attributes:
        min_probability: minimum occupancy probability; None uses the daemon's threshold.
        low_m, high_m: limits of the centres' z.
    """

    min_probability: float | None = None
    low_m: float = -np.inf
    high_m: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class ChunkSurface:
    """The visible cells of a chunk.

    Attributes:
        origin_m: (3,) lowest corner of the chunk, map frame.
        cell_m: edge of a cell.
        local: (N, 3) int16, indices within the chunk.
        normals: (N, 3) float32, outward unit vectors; 0 if opposite sides are free.
        probability: (N,) float32.
        count: (N,) uint16.
        changed_ns: (N,) int64.
    """

    origin_m: NDArray[np.float64]
    cell_m: float
    local: NDArray[np.int16]
    normals: NDArray[np.float32]
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]
    changed_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.local)


def drawn_of(mirror: MapMirror, chunks: Chunks, chunk: Chunk, chosen: Filter) -> ChunkSurface:
    """Return the cells of a chunk that pass a filter and have a free side."""
    cell_m, edge = mirror.cell_m, chunks.edge
    cells = mirror.cells(
        "occupied", min_probability=chosen.min_probability, keys=chunks.blocks_of(chunk)
    )
    z_m = cells.centres_m[:, 2]
    passed = (z_m >= chosen.low_m) & (z_m <= chosen.high_m)
    index = np.floor(cells.centres_m / cell_m).astype(np.int64) - np.asarray(chunk) * edge
    near = ((index >= -1) & (index <= edge)).all(axis=1) & passed
    filled = np.zeros((edge + 2,) * 3, np.bool_)
    filled[tuple((index[near] + 1).T)] = True
    inside = near & ((index >= 0) & (index < edge)).all(axis=1)
    at = np.flatnonzero(inside)
    shown, normals = faces_shown(filled, index[at] + 1)
    at = at[shown]
    return ChunkSurface(
        np.asarray(chunk) * (edge * cell_m),
        cell_m,
        index[at].astype(np.int16),
        normals[shown],
        cells.probability[at],
        cells.count[at],
        cells.changed_ns[at],
    )


def faces_shown(
    filled: NDArray[np.bool_], index: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return which cells have a free side, and the direction of their free sides.

    Args:
        filled: (E, E, E) whether a cell is drawn.
        index: (N, 3) cells, none at the border.

    Returns:
        (N,) bool and (N, 3) unit vectors towards the free sides.
    """
    normals = np.zeros((len(index), 3), np.float32)
    shown = np.zeros(len(index), np.bool_)
    for axis in range(3):
        for step in (-1, 1):
            beside = index.copy()
            beside[:, axis] += step
            free = ~filled[tuple(beside.T)]
            shown |= free
            normals[:, axis] += step * free
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return shown, normals / np.maximum(length, 1)


def coarser(drawn: ChunkSurface, factor: int) -> ChunkSurface:
    """Merge factor**3 cells into one, which has the values of one of them."""
    if factor == 1:
        return drawn
    local, first = np.unique(drawn.local // factor, axis=0, return_index=True)
    return ChunkSurface(
        drawn.origin_m,
        drawn.cell_m * factor,
        local,
        drawn.normals[first],
        drawn.probability[first],
        drawn.count[first],
        drawn.changed_ns[first],
    )


def points_m(drawn: ChunkSurface) -> NDArray[np.float64]:
    """Centres of the cells, (N, 3), map frame."""
    return drawn.origin_m + (drawn.local + 0.5) * drawn.cell_m
