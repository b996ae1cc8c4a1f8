"""Which cells a listener was told to be occupied, so that it hears which are not any more."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapperd.client.block_table import keys_of, names_of
from mapperd.client.cells import Cells
from mapperd.wire.blocks import CELLS
from mapperd.wire.messages import BLOCK_EDGE

__all__ = ["ToldCells"]

_NONE = bytes(CELLS // 8)
_STEPS = np.array([1, BLOCK_EDGE, BLOCK_EDGE**2])


class ToldCells:
    """Occupied cells by block, a bit each."""

    def __init__(self) -> None:
        self._bits: dict[bytes, bytes] = {}

    def clear(self) -> None:
        """Nothing was told."""
        self._bits.clear()

    def replace(self, names: Iterable[bytes], cells: Cells, cell_m: float) -> NDArray[np.float64]:
        """Tell the cells that are occupied in some blocks now.

        Args:
            names: of the blocks.
            cells: all that are occupied in them.
            cell_m: edge of one.

        Returns:
            (N, 3) centres of those that were told before, and are not occupied any more.
        """
        now = _bits_by_block(cells, cell_m)
        before = []
        gone_from = []
        for name in names:
            old = self._bits.pop(name, None)
            new = now.get(name, _NONE)
            if new != _NONE:
                self._bits[name] = new
            if old is not None and old != new:
                before.append((old, new))
                gone_from.append(name)
        if not before:
            return np.zeros((0, 3))
        old_bits, new_bits = _unpacked(o for o, _ in before), _unpacked(n for _, n in before)
        row, offset = np.nonzero(old_bits & ~new_bits)
        local = offset[:, None] // _STEPS % BLOCK_EDGE
        index = keys_of(gone_from)[row].astype(np.int64) * BLOCK_EDGE + local
        return np.asarray((index + 0.5) * cell_m, np.float64)


def _bits_by_block(cells: Cells, cell_m: float) -> dict[bytes, bytes]:
    if not len(cells):
        return {}
    index = np.floor(cells.centres_m / cell_m).astype(np.int64)
    owner = index // BLOCK_EDGE
    offset = (index % BLOCK_EDGE) @ _STEPS
    begins = np.r_[True, (owner[1:] != owner[:-1]).any(axis=1)]  # of runs of one block's cells
    names = names_of(owner[begins].astype(np.int32))
    row_of: dict[bytes, int] = {}
    rows = np.array([row_of.setdefault(name, len(row_of)) for name in names])
    bits = np.zeros((len(row_of), CELLS), bool)
    bits[rows[np.cumsum(begins) - 1], offset] = True
    packed = np.packbits(bits, axis=1)
    return {name: packed[row].tobytes() for name, row in row_of.items()}


def _unpacked(packed: Iterable[bytes]) -> NDArray[np.bool_]:
    rows = np.frombuffer(b"".join(packed), np.uint8).reshape(-1, CELLS // 8)
    return np.unpackbits(rows, axis=1).astype(bool)
