"""The map cut into cubes that are sent to a browser one by one, nearest first."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.wire.messages import BLOCK_EDGE

__all__ = ["FIRST_SPAN", "Chunk", "Chunks"]

FIRST_SPAN = 4
"""Blocks along the edge of a chunk at first: 32 cells."""

LAST_SPAN = 32
"""256 cells: offsets of half a cell within a chunk stay exact in half precision."""

Chunk = tuple[int, int, int]


class Chunks:
    """Which chunks there are, and which of them are not drawn as they are now.

    Their edge doubles where too many of them show something: a browser pays for each.

    Args:
        most: chunks that show something at once.

    Attributes:
        span: blocks along the edge of a chunk.
    """

    def __init__(self, most: int) -> None:
        self.span = FIRST_SPAN
        self._most = most
        self._known: set[Chunk] = set()
        self._stale: set[Chunk] = set()
        self._shown: set[Chunk] = set()

    @property
    def edge(self) -> int:
        """Cells along the edge of a chunk."""
        return self.span * BLOCK_EDGE

    @property
    def stale(self) -> int:
        """Chunks that are to be drawn."""
        return len(self._stale)

    @property
    def shown(self) -> frozenset[Chunk]:
        """Chunks that show something."""
        return frozenset(self._shown)

    @property
    def crowded(self) -> bool:
        """So many show something that they are to `grow`."""
        return len(self._shown) > self._most and self.span < LAST_SPAN

    def touch(self, keys: ArrayLike) -> None:
        """Blocks (N, 3) are others than before, and with them the faces of their neighbours."""
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
        """Chunks are twice as large from now on; all that was drawn is to go."""
        self.span *= 2
        self._known = {(x // 2, y // 2, z // 2) for x, y, z in self._known}
        self._stale = set(self._known)
        self._shown.clear()

    def shows(self, chunk: Chunk, *, something: bool) -> None:
        """A chunk was drawn; it shows something, or nothing."""
        (self._shown.add if something else self._shown.discard)(chunk)

    def touch_all(self) -> None:
        """Everything is to be drawn anew."""
        self._stale = set(self._known)

    def touch_some(self, chunks: Iterable[Chunk]) -> None:
        """These are to be drawn anew."""
        self._stale |= self._known.intersection(chunks)

    def forget(self) -> None:
        """There is no map any more."""
        self._known.clear()
        self._stale.clear()
        self._shown.clear()
        self.span = FIRST_SPAN

    def take(self, near_m: ArrayLike, cell_m: float, most: int) -> list[Chunk]:
        """Those to be drawn next, nearest to a place first; they count as drawn."""
        if not self._stale:
            return []
        waiting = np.array(sorted(self._stale), np.int64)
        centres_m = (waiting + 0.5) * (self.edge * cell_m)
        order = np.argsort(np.linalg.norm(centres_m - np.asarray(near_m), axis=1), kind="stable")
        taken = [(int(x), int(y), int(z)) for x, y, z in waiting[order[:most]]]
        self._stale.difference_update(taken)
        return taken

    def blocks_of(self, chunk: Chunk) -> NDArray[np.int32]:
        """Keys of the blocks of a chunk and of those around it, (M, 3)."""
        return _cube(self.span + 2) + np.asarray(chunk, np.int32) * self.span - 1

    def _chunks_of(self, blocks: NDArray[np.int64]) -> set[Chunk]:
        return set(map(tuple, np.unique(blocks // self.span, axis=0).tolist()))


def _cube(edge: int) -> NDArray[np.int32]:
    sides: NDArray[np.int32] = np.indices((edge,) * 3, np.int32)
    return np.ascontiguousarray(sides.reshape(3, -1).T)
