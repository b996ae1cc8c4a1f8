"""Blocks by their keys in arrays that grow by doubling, and cells as arrays."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet

__all__ = ["BlockTable", "Cells", "keys_of", "names_of"]

FIRST_ROWS = 256

Number = TypeVar("Number", bound=np.generic)


class BlockTable:
    """Each block that has a known cell.

    Args:
        counts: of observations are held too.

    Attributes:
        keys: (R, 3) int32, of rows in use and of others.
        cells: (R, 512) int8.
        counts: (R, 512) uint8; (R, 0) where none are held.
        changed_ns: (R,) int64, Unix.
    """

    def __init__(self, *, counts: bool) -> None:
        self.keys = np.zeros((0, 3), np.int32)
        self.cells = np.zeros((0, CELLS), np.int8)
        self.counts = np.zeros((0, CELLS if counts else 0), np.uint8)
        self.changed_ns = np.zeros(0, np.int64)
        self._row_of: dict[bytes, int] = {}
        self._unused: list[int] = []

    def __len__(self) -> int:
        """Blocks."""
        return len(self._row_of)

    def put(self, blocks: BlockSet, stamp_ns: int) -> None:
        """Take blocks, each key once; drop those without a known cell."""
        known = (blocks.cells != UNKNOWN).any(axis=1)
        names = names_of(blocks.keys)
        for at in np.nonzero(~known)[0]:
            self._drop(names[at])
        kept = np.nonzero(known)[0]
        rows = np.fromiter((self._taken(names[at]) for at in kept), np.intp, len(kept))
        self.keys[rows] = blocks.keys[kept]
        self.cells[rows] = blocks.cells[kept]
        self.changed_ns[rows] = stamp_ns - blocks.ages_ms[kept].astype(np.int64) * 1_000_000
        if blocks.counts is not None:
            self.counts[rows] = blocks.counts[kept]

    def rows(self, names: Iterable[bytes] | None = None) -> NDArray[np.intp]:
        """Rows of those blocks that are there; None is all."""
        if names is None:
            return np.fromiter(self._row_of.values(), np.intp, len(self._row_of))
        return np.array([self._row_of[name] for name in names if name in self._row_of], np.intp)

    def row_of_each(self, names: list[bytes]) -> NDArray[np.intp]:
        """The row of each block, -1 where it is not there."""
        return np.fromiter((self._row_of.get(name, -1) for name in names), np.intp, len(names))

    def _taken(self, name: bytes) -> int:
        row = self._row_of.get(name)
        if row is None:
            if not self._unused:
                self._grow()
            row = self._row_of[name] = self._unused.pop()
        return row

    def _drop(self, name: bytes) -> None:
        row = self._row_of.pop(name, None)
        if row is not None:
            self._unused.append(row)

    def _grow(self) -> None:
        held = len(self.keys)
        rows = max(FIRST_ROWS, 2 * held)
        self.keys = _longer(self.keys, rows)
        self.cells = _longer(self.cells, rows)
        self.counts = _longer(self.counts, rows)
        self.changed_ns = _longer(self.changed_ns, rows)
        self._unused = list(range(rows - 1, held - 1, -1))


def _longer(array: NDArray[Number], rows: int) -> NDArray[Number]:
    longer = np.zeros((rows, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    return longer


def names_of(keys: NDArray[np.int32]) -> list[bytes]:
    """Each key (N, 3) as one hashable value."""
    named: list[bytes] = np.ascontiguousarray(keys, "<i4").view("V12").ravel().tolist()
    return named


def keys_of(names: Iterable[bytes]) -> NDArray[np.int32]:
    """What `names_of` named, (N, 3) int32."""
    return np.frombuffer(b"".join(names), "<i4").reshape(-1, 3).astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Some cells of a mirror, in no particular order.

    Attributes:
        centres_m: (N, 3) float64, map frame.
        log_odds: (N,) float32, quantised.
        probability: (N,) float32, of being occupied.
        count: (N,) uint16: that often observed at least; 0 where counts are not told.
        changed_ns: (N,) int64, Unix: when their block changed last.
    """

    centres_m: NDArray[np.float64]
    log_odds: NDArray[np.float32]
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]
    changed_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.log_odds)
