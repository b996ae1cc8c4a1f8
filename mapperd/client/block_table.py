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
        orders: (R,) int64, of the messages that told them.
        gone: orders of blocks that were let go, as long as something older may bring them back.
    """

    def __init__(self, *, counts: bool) -> None:
        self.keys = np.zeros((0, 3), np.int32)
        self.cells = np.zeros((0, CELLS), np.int8)
        self.counts = np.zeros((0, CELLS if counts else 0), np.uint8)
        self.changed_ns = np.zeros(0, np.int64)
        self.orders = np.zeros(0, np.int64)
        self.gone: dict[bytes, int] = {}
        self._row_of: dict[bytes, int] = {}
        self._unused: list[int] = []

    def __len__(self) -> int:
        """Blocks."""
        return len(self._row_of)

    def put(self, blocks: BlockSet, stamp_ns: int, order: int = 0) -> NDArray[np.int32]:
        """Take blocks, each key once; those without a known cell are let go.

        Where something of a higher order was told, that stays.

        Returns:
            (N, 3), keys of those that were taken.
        """
        known = (blocks.cells != UNKNOWN).any(axis=1)
        names = names_of(blocks.keys)
        taken = self._orders_of(names) <= order
        for at in np.nonzero(taken & ~known)[0]:
            self._drop(names[at])
            if order:  # below 0 there is none that could bring it back
                self.gone[names[at]] = order
        kept = np.nonzero(taken & known)[0]
        rows = np.fromiter((self._taken(names[at]) for at in kept), np.intp, len(kept))
        self.keys[rows] = blocks.keys[kept]
        self.cells[rows] = blocks.cells[kept]
        self.changed_ns[rows] = stamp_ns - blocks.ages_ms[kept].astype(np.int64) * 1_000_000
        if blocks.counts is not None:
            self.counts[rows] = blocks.counts[kept]
        self.orders[rows] = order
        return blocks.keys[taken]

    def begin_orders(self) -> None:
        """Whatever comes from now on is newer than what is here."""
        self.orders[:] = 0
        self.gone.clear()

    def settle(self, order: int) -> None:
        """Nothing below an order comes any more."""
        self.gone = {name: gone for name, gone in self.gone.items() if gone > order}

    def rows(self, names: Iterable[bytes] | None = None) -> NDArray[np.intp]:
        """Rows of those blocks that are there; None is all."""
        if names is None:
            return np.fromiter(self._row_of.values(), np.intp, len(self._row_of))
        return np.array([self._row_of[name] for name in names if name in self._row_of], np.intp)

    def row_of_each(self, names: list[bytes]) -> NDArray[np.intp]:
        """The row of each block, -1 where it is not there."""
        return np.fromiter((self._row_of.get(name, -1) for name in names), np.intp, len(names))

    def _orders_of(self, names: list[bytes]) -> NDArray[np.int64]:
        """The highest order that was told of each block; 0 where there was none."""
        rows = self.row_of_each(names)
        orders = np.zeros(len(names), np.int64)
        orders[rows >= 0] = self.orders[rows[rows >= 0]]
        if self.gone:
            for at in np.nonzero(rows < 0)[0]:
                orders[at] = self.gone.get(names[at], 0)
        return orders

    def _taken(self, name: bytes) -> int:
        row = self._row_of.get(name)
        if row is None:
            if not self._unused:
                self._grow()
            row = self._row_of[name] = self._unused.pop()
            self.gone.pop(name, None)
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
        self.orders = _longer(self.orders, rows)
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
