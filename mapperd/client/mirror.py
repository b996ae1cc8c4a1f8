"""A copy of the daemon's map, as far as a client is told of it."""

import hashlib
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.point_arrays import points_of
from mapperd.stream.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.stream.messages import BLOCK_EDGE, Interest, MapFacts

__all__ = ["Cells", "MapMirror"]

FIRST_SLOTS = 256

Kind = Literal["occupied", "free", "known"]

_LOCAL = np.stack(np.unravel_index(np.arange(CELLS), (BLOCK_EDGE,) * 3, order="F"), axis=-1).astype(
    np.int64
)
"""(512, 3): where in its block each cell is."""


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


class MapMirror:
    """Blocks of the map, replaced as the daemon tells of them; of one thread.

    Args:
        facts: of the map.
        interest: what is told of it.

    Attributes:
        facts, interest: as given.
        revision: of the newest blocks.
        complete: all of the interest is as of this revision, or newer; None while it is not.
    """

    def __init__(self, facts: MapFacts, interest: Interest) -> None:
        self.facts = facts
        self.interest = interest
        self.revision = 0
        self.complete: int | None = None
        self._slots: dict[bytes, int] = {}
        self._free: list[int] = []
        self._keys = np.zeros((0, 3), np.int32)
        self._cells = np.zeros((0, CELLS), np.int8)
        self._counts = np.zeros((0, CELLS), np.uint8)
        self._changed_ns = np.zeros(0, np.int64)

    def __len__(self) -> int:
        """Blocks with a known cell."""
        return len(self._slots)

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return float(self.facts.resolution_m * 2**self.interest.level)

    def put(self, blocks: BlockSet, stamp_ns: int) -> None:
        """Take blocks as they were at a moment; those without a known cell are forgotten."""
        known = (blocks.cells != UNKNOWN).any(axis=1)
        rows = np.fromiter(
            (
                self._slot_of(key) if has else self._drop(key)
                for key, has in zip(_names(blocks.keys), known, strict=True)
            ),
            np.intp,
            len(blocks),
        )
        at = rows[known]
        self._keys[at] = blocks.keys[known]
        self._cells[at] = blocks.cells[known]
        if blocks.counts is not None:
            self._counts[at] = blocks.counts[known]
        self._changed_ns[at] = stamp_ns - blocks.ages_ms[known].astype(np.int64) * 1_000_000

    def forget(self) -> None:
        """Nothing is known any more."""
        self._slots.clear()
        self._free = list(range(len(self._keys)))
        self._cells[:] = UNKNOWN
        self.complete = None

    def blocks(self) -> BlockSet:
        """All blocks with a known cell, sorted by z, y, x; their ages are 0."""
        at = np.fromiter(self._slots.values(), np.intp, len(self._slots))
        at = at[np.lexsort(self._keys[at].T)]
        counts = self._counts[at] if self.interest.detail == "counts" else None
        return BlockSet(self._keys[at], np.zeros(len(at), np.uint32), self._cells[at], counts)

    def digest(self) -> str:
        """SHA-256 of all blocks; equal mirrors have equal ones, however they came about."""
        blocks = self.blocks()
        digest = hashlib.sha256(np.ascontiguousarray(blocks.keys, "<i4").tobytes())
        digest.update(blocks.cells.tobytes())
        if blocks.counts is not None:
            digest.update(blocks.counts.tobytes())
        return digest.hexdigest()

    def cells(
        self,
        kind: Kind = "occupied",
        *,
        min_probability: float | None = None,
        keys: ArrayLike | None = None,
    ) -> Cells:
        """The cells of a class.

        Args:
            kind: by the thresholds of the daemon.
            min_probability: instead of the threshold of occupied cells.
            keys: (M, 3), of these blocks alone.
        """
        at = self._at(keys)
        cells = self._cells[at]
        row, cell = np.nonzero(self._chosen(cells, kind, min_probability))
        log_odds = self._log_odds(cells[row, cell])
        bits = self._counts[at[row], cell].astype(np.uint16)
        return Cells(
            (self._keys[at[row]].astype(np.int64) * BLOCK_EDGE + _LOCAL[cell] + 0.5) * self.cell_m,
            log_odds,
            1 / (1 + np.exp(-log_odds)),
            np.where(bits > 0, 1 << np.maximum(bits, 1) - 1, 0).astype(np.uint16),
            self._changed_ns[at[row]],
        )

    def classify(self, points_m: ArrayLike) -> NDArray[np.int8]:
        """1 occupied, 0 free, -1 unknown or neither, at points (N, 3) of the map's frame.

        Raises:
            ValueError: no points.
        """
        points = points_of(points_m)
        index = np.floor(points / self.cell_m).astype(np.int64)
        keys = (index >> 3).astype(np.int32)
        local = index & (BLOCK_EDGE - 1)
        offset = local[:, 0] + BLOCK_EDGE * (local[:, 1] + BLOCK_EDGE * local[:, 2])
        at = np.fromiter((self._slots.get(name, -1) for name in _names(keys)), np.intp, len(points))
        cells = np.full(len(points), UNKNOWN, np.int8)
        cells[at >= 0] = self._cells[at[at >= 0], offset[at >= 0]]
        classes = np.full(len(points), -1, np.int8)
        classes[self._chosen(cells, "free", None)] = 0
        classes[self._chosen(cells, "occupied", None)] = 1
        return classes

    def _at(self, keys: ArrayLike | None) -> NDArray[np.intp]:
        if keys is None:
            return np.fromiter(self._slots.values(), np.intp, len(self._slots))
        names = _names(np.asarray(keys, np.int32).reshape(-1, 3))
        return np.array([self._slots[name] for name in names if name in self._slots], np.intp)

    def _chosen(
        self, cells: NDArray[np.int8], kind: Kind, min_probability: float | None
    ) -> NDArray[np.bool_]:
        known = cells != UNKNOWN
        if kind == "known":
            return known
        if self.interest.detail == "classes":
            return cells == 1 if kind == "occupied" else cells == -1
        log_odds = self._log_odds(cells)
        if kind == "free":
            return known & (log_odds < self.facts.free_log_odds)
        if min_probability is None:
            return known & (log_odds > self.facts.occupied_log_odds)
        with np.errstate(divide="ignore"):
            least = np.log(min_probability) - np.log1p(-min_probability)
        return known & (log_odds >= least)

    def _log_odds(self, cells: NDArray[np.int8]) -> NDArray[np.float32]:
        """Quantised log-odds; of classes, a value a step beyond their thresholds."""
        if self.interest.detail != "classes":
            return cells * np.float32(self.facts.log_odds_step)
        free = np.float32(self.facts.free_log_odds - self.facts.log_odds_step)
        occupied = np.float32(self.facts.occupied_log_odds + self.facts.log_odds_step)
        middle = np.float32((self.facts.free_log_odds + self.facts.occupied_log_odds) / 2)
        return np.choose(cells + 1, [free, middle, occupied]).astype(np.float32)

    def _slot_of(self, name: bytes) -> int:
        slot = self._slots.get(name)
        if slot is None:
            if not self._free:
                self._grow()
            slot = self._slots[name] = self._free.pop()
        return slot

    def _drop(self, name: bytes) -> int:
        slot = self._slots.pop(name, None)
        if slot is not None:
            self._cells[slot] = UNKNOWN
            self._counts[slot] = 0
            self._free.append(slot)
        return -1

    def _grow(self) -> None:
        held = len(self._keys)
        more = max(FIRST_SLOTS, held)
        self._keys = np.concatenate([self._keys, np.zeros((more, 3), np.int32)])
        self._cells = np.concatenate([self._cells, np.full((more, CELLS), UNKNOWN, np.int8)])
        self._counts = np.concatenate([self._counts, np.zeros((more, CELLS), np.uint8)])
        self._changed_ns = np.concatenate([self._changed_ns, np.zeros(more, np.int64)])
        self._free = list(range(held + more - 1, held - 1, -1))


def _names(keys: NDArray[np.int32]) -> list[bytes]:
    """Each key as one hashable value."""
    named: list[bytes] = np.ascontiguousarray(keys, "<i4").view("V12").ravel().tolist()
    return named
