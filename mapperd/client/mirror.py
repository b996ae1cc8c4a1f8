"""A copy of the daemon's map, as far as a client is told of it."""

import hashlib
import threading
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.client.block_table import BlockTable, Cells, names_of
from mapperd.mapping.probability import points_of, probabilities_of
from mapperd.wire.blocks import CELLS, MAX_KEY, UNKNOWN, BlockSet
from mapperd.wire.messages import BLOCK_EDGE, Interest, MapFacts

if TYPE_CHECKING:
    from mapperd.config.tree import Config
    from mapperd.mapping.sonar_map import SonarMap

__all__ = ["MapMirror"]

Kind = Literal["occupied", "free", "known"]

_LOCAL = np.stack(np.unravel_index(np.arange(CELLS), (BLOCK_EDGE,) * 3, order="F"), axis=-1).astype(
    np.int64
)
"""(512, 3): where in its block each cell is."""


class MapMirror:
    """Blocks of the map, replaced as the daemon tells of them.

    Any thread may ask it: what it gives are copies, and each call sees messages wholly or not at
    all. For several calls on one state, hold `lock` around them, and not for long: what comes in
    waits meanwhile.

    Args:
        facts: of the map.
        interest: what is told of it.

    Attributes:
        lock: held by each call; a thread that has it may take it again.
        facts, interest: as given.
        revision: the newest of all blocks.
        complete: all of the interest was as of this revision, or newer, when the daemon last said
            so; None before.
    """

    complete: int | None

    def __init__(self, facts: MapFacts, interest: Interest) -> None:
        self.lock = threading.RLock()
        self.begin(facts, interest)

    def begin(self, facts: MapFacts, interest: Interest) -> None:
        """Mirror another map, or another part of it, of which nothing is known yet."""
        with self.lock:
            self.facts = facts
            self.interest = interest
            self.revision = 0
            self.complete = None
            self._table = BlockTable(counts=interest.detail == "counts")

    def __len__(self) -> int:
        """Blocks with a known cell."""
        return len(self._table)

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return float(self.facts.resolution_m * 2**self.interest.level)

    def put(self, blocks: BlockSet, stamp_ns: int) -> None:
        """Take blocks as they were at a moment, each key once; drop those without a known cell."""
        with self.lock:
            self._table.put(blocks, stamp_ns)

    def forget(self) -> None:
        """Nothing is known any more."""
        self.begin(self.facts, self.interest)

    def blocks(self) -> BlockSet:
        """All blocks with a known cell, sorted by z, y, x; their ages are 0."""
        with self.lock:
            table = self._table
            at = table.rows()
            at = at[np.lexsort(table.keys[at].T)]
            counts = table.counts[at] if self.interest.detail == "counts" else None
            return BlockSet(table.keys[at], np.zeros(len(at), np.uint32), table.cells[at], counts)

    def keys(self) -> NDArray[np.int32]:
        """Of all blocks with a known cell, (N, 3), in no particular order."""
        with self.lock:
            return self._table.keys[self._table.rows()]

    def digest(self) -> str:
        """SHA-256 of all blocks; equal mirrors have equal ones, however they came about."""
        blocks = self.blocks()
        digest = hashlib.sha256(np.ascontiguousarray(blocks.keys, "<i4").tobytes())
        digest.update(blocks.cells.tobytes())
        if blocks.counts is not None:
            digest.update(blocks.counts.tobytes())
        return digest.hexdigest()

    def cells_of(self, keys: ArrayLike) -> NDArray[np.int8]:
        """The cells (N, 512) of blocks (N, 3), x fastest; -128 is unknown."""
        names = names_of(np.asarray(keys, np.int32).reshape(-1, 3))
        with self.lock:
            at = self._table.row_of_each(names)
            cells = np.full((len(names), CELLS), UNKNOWN, np.int8)
            cells[at >= 0] = self._table.cells[at[at >= 0]]
        return cells

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
        with self.lock:
            names = None if keys is None else names_of(np.asarray(keys, np.int32).reshape(-1, 3))
            at = self._table.rows(names)
            cells = self._table.cells[at]
            row, cell = np.nonzero(self._chosen(cells, kind, min_probability))
            return self._cells_at(at[row], cell, cells[row, cell])

    def classify(self, points_m: ArrayLike) -> NDArray[np.int8]:
        """1 occupied, 0 free, -1 unknown or neither, at points (N, 3) of the map's frame.

        Raises:
            ValueError: no points.
        """
        with self.lock:
            reach = BLOCK_EDGE * (MAX_KEY - 1)
            index = np.floor(points_of(points_m) / self.cell_m)
            index = np.nan_to_num(index, nan=reach).clip(-reach, reach).astype(np.int64)
            local = index & (BLOCK_EDGE - 1)
            offset = local[:, 0] + BLOCK_EDGE * (local[:, 1] + BLOCK_EDGE * local[:, 2])
            at = self._table.row_of_each(names_of((index >> 3).astype(np.int32)))
            cells = np.full(len(index), UNKNOWN, np.int8)
            cells[at >= 0] = self._table.cells[at[at >= 0], offset[at >= 0]]
            classes = np.full(len(index), -1, np.int8)
            classes[self._chosen(cells, "free", None)] = 0
            classes[self._chosen(cells, "occupied", None)] = 1
            return classes

    def to_map(self, config: "Config | None" = None) -> "SonarMap":
        """Every known cell as a voxel of a map, observed once, which all exports take.

        Args:
            config: the daemon's settings, as far as they are known; grid, thresholds and clamps
                are the mirror's.
        """
        # Only here: a client that just looks needs neither the settings nor the core.
        from mapperd.client.to_map import map_of  # noqa: PLC0415

        with self.lock:
            facts, cell_m, cells = self.facts, self.cell_m, self.cells("known")
        return map_of(cells, cell_m, facts, config)

    def _cells_at(
        self, at: NDArray[np.intp], cell: NDArray[np.intp], steps: NDArray[np.int8]
    ) -> Cells:
        table = self._table
        log_odds = self._log_odds(steps)
        bits = (
            table.counts[at, cell].astype(np.uint16)
            if self.interest.detail == "counts"
            else np.zeros(len(at), np.uint16)
        )
        first = table.keys[at].astype(np.int64) * BLOCK_EDGE
        return Cells(
            ((first + _LOCAL[cell]).astype(np.float64) + 0.5) * self.cell_m,
            log_odds,
            probabilities_of(log_odds).astype(np.float32),
            np.where(bits > 0, 1 << np.maximum(bits, 1) - 1, 0).astype(np.uint16),
            table.changed_ns[at],
        )

    def _chosen(
        self, cells: NDArray[np.int8], kind: Kind, min_probability: float | None
    ) -> NDArray[np.bool_]:
        known: NDArray[np.bool_] = cells != UNKNOWN
        if kind == "known":
            return known
        if self.interest.detail == "classes":
            return np.asarray(cells == (1 if kind == "occupied" else -1))
        # In double precision, as the daemon's own steps are chosen.
        log_odds = cells * np.float64(self.facts.log_odds_step)
        if kind == "free":
            return np.asarray(known & (log_odds < self.facts.free_log_odds))
        if min_probability is None:
            return np.asarray(known & (log_odds > self.facts.occupied_log_odds))
        with np.errstate(divide="ignore"):
            least = np.log(min_probability) - np.log1p(-min_probability)
        return np.asarray(known & (log_odds >= least))

    def _log_odds(self, cells: NDArray[np.int8]) -> NDArray[np.float32]:
        """Quantised log-odds; of classes, a value a step beyond their thresholds."""
        facts = self.facts
        if self.interest.detail != "classes":
            return cells * np.float32(facts.log_odds_step)
        middle = (facts.free_log_odds + facts.occupied_log_odds) / 2
        low = facts.free_log_odds - facts.log_odds_step
        high = facts.occupied_log_odds + facts.log_odds_step
        values = np.array([low, middle, high], np.float32)
        return np.asarray(values[np.clip(cells, -1, 1).astype(np.intp) + 1])
