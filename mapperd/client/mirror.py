"""A copy of the daemon's map: its blocks, its cells, and a map that can be saved."""

import hashlib
import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.mapping.probability import points_of, probabilities_of
from mapperd.wire.blocks import CELLS, MAX_KEY, UNKNOWN, BlockSet
from mapperd.wire.messages import BLOCK_EDGE, Interest, MapInfo

if TYPE_CHECKING:
    from mapperd.config.tree import Config
    from mapperd.mapping.sonar_map import SonarMap

__all__ = ["BlockTable", "Cells", "MapMirror", "keys_of", "map_of", "names_of"]

FIRST_ROWS = 256

Number = TypeVar("Number", bound=np.generic)


class BlockTable:
    """Blocks with a known cell, in arrays that grow by doubling.

    Args:
        counts: hold counts of observations too.

    Attributes:
        keys: (R, 3) int32; R counts used and unused rows.
        cells: (R, 512) int8.
        counts: (R, 512) uint8; (R, 0) without counts.
        changed_ns: (R,) int64, Unix time of the last change.
    """

    def __init__(self, *, counts: bool) -> None:
        self.keys = np.zeros((0, 3), np.int32)
        self.cells = np.zeros((0, CELLS), np.int8)
        self.counts = np.zeros((0, CELLS if counts else 0), np.uint8)
        self.changed_ns = np.zeros(0, np.int64)
        self._row_of: dict[bytes, int] = {}
        self._unused: list[int] = []

    def __len__(self) -> int:
        """Return the number of blocks."""
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
        """Return the rows of blocks, without those that are missing; None is all blocks."""
        if names is None:
            return np.fromiter(self._row_of.values(), np.intp, len(self._row_of))
        return np.array([self._row_of[name] for name in names if name in self._row_of], np.intp)

    def row_of_each(self, names: list[bytes]) -> NDArray[np.intp]:
        """Return the row of each block, -1 for missing ones."""
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
    """Return each key (N, 3) as one hashable value."""
    named: list[bytes] = np.ascontiguousarray(keys, "<i4").view("V12").ravel().tolist()
    return named


def keys_of(names: Iterable[bytes]) -> NDArray[np.int32]:
    """Return the keys (N, 3) int32 of `names_of`."""
    return np.frombuffer(b"".join(names), "<i4").reshape(-1, 3).astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Some cells of a mirror, in no particular order.

    Attributes:
        centres_m: (N, 3) float64, map frame.
        log_odds: (N,) float32, quantised.
        probability: (N,) float32, of being occupied.
        count: (N,) uint16, lower bound of the number of observations; 0 without counts.
        changed_ns: (N,) int64, Unix time when their block changed last.
    """

    centres_m: NDArray[np.float64]
    log_odds: NDArray[np.float32]
    probability: NDArray[np.float32]
    count: NDArray[np.uint16]
    changed_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.log_odds)


Kind = Literal["occupied", "free", "known"]

_LOCAL = np.stack(np.unravel_index(np.arange(CELLS), (BLOCK_EDGE,) * 3, order="F"), axis=-1).astype(
    np.int64
)
"""(512, 3): index of each cell in its block."""


class MapMirror:
    """Blocks of the map, kept up to date by the daemon's messages.

    Any thread may use it. Results are copies; each call sees a message completely or not at all.
    For several calls on one state, hold `lock` around them, and only briefly: new messages wait
    for it.

    Args:
        info: of the map.
        interest: part of the map that the daemon sends.

    Attributes:
        lock: held by each call; reentrant.
        info, interest: as given.
        revision: newest revision of all blocks.
        complete: revision up to which the mirror was last complete; None before the first time.
    """

    complete: int | None

    def __init__(self, info: MapInfo, interest: Interest) -> None:
        self.lock = threading.RLock()
        self.begin(info, interest)

    def begin(self, info: MapInfo, interest: Interest) -> None:
        """Begin with an empty mirror of a map or of another part of it."""
        with self.lock:
            self.info = info
            self.interest = interest
            self.revision = 0
            self.complete = None
            self._table = BlockTable(counts=interest.detail == "counts")

    def __len__(self) -> int:
        """Return the number of blocks with a known cell."""
        return len(self._table)

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return float(self.info.resolution_m * 2**self.interest.level)

    def put(self, blocks: BlockSet, stamp_ns: int) -> None:
        """Replace blocks by their state at a Unix time; drop those without a known cell.

        Each key occurs once.
        """
        with self.lock:
            self._table.put(blocks, stamp_ns)

    def forget(self) -> None:
        """Drop all blocks."""
        self.begin(self.info, self.interest)

    def blocks(self) -> BlockSet:
        """Return all blocks with a known cell, sorted by z, y, x; their ages are 0."""
        with self.lock:
            table = self._table
            at = table.rows()
            at = at[np.lexsort(table.keys[at].T)]
            counts = table.counts[at] if self.interest.detail == "counts" else None
            return BlockSet(table.keys[at], np.zeros(len(at), np.uint32), table.cells[at], counts)

    def keys(self) -> NDArray[np.int32]:
        """Return the keys (N, 3) of all blocks with a known cell, in no particular order."""
        with self.lock:
            return self._table.keys[self._table.rows()]

    def digest(self) -> str:
        """Return the SHA-256 of all blocks; it does not depend on their order of arrival."""
        blocks = self.blocks()
        digest = hashlib.sha256(np.ascontiguousarray(blocks.keys, "<i4").tobytes())
        digest.update(blocks.cells.tobytes())
        if blocks.counts is not None:
            digest.update(blocks.counts.tobytes())
        return digest.hexdigest()

    def cells_of(self, keys: ArrayLike) -> NDArray[np.int8]:
        """Return the cells (N, 512) of blocks (N, 3), x fastest; -128 is unknown."""
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
        """Return the cells of a class.

        Args:
            kind: class by the thresholds of the daemon.
            min_probability: replaces the threshold of occupied cells.
            keys: (M, 3) of the blocks to search; None is all.
        """
        with self.lock:
            names = None if keys is None else names_of(np.asarray(keys, np.int32).reshape(-1, 3))
            at = self._table.rows(names)
            cells = self._table.cells[at]
            row, cell = np.nonzero(self._chosen(cells, kind, min_probability))
            return self._cells_at(at[row], cell, cells[row, cell])

    def classify(self, points_m: ArrayLike) -> NDArray[np.int8]:
        """Classify points: 1 occupied, 0 free, -1 unknown or neither.

        Args:
            points_m: (N, 3), metres, map frame.

        Returns:
            (N,) int8.

        Raises:
            ValueError: `points_m` has another shape.
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
        """Make a map that can be saved and exported; each known cell is a voxel, observed once.

        Args:
            config: settings of the daemon, as far as known; grid, thresholds and clamps are the
                mirror's.
        """
        with self.lock:
            info, cell_m, cells = self.info, self.cell_m, self.cells("known")
        return map_of(cells, cell_m, info, config)

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
        # In double precision, like the daemon.
        log_odds = cells * np.float64(self.info.log_odds_step)
        if kind == "free":
            return np.asarray(known & (log_odds < self.info.free_log_odds))
        if min_probability is None:
            return np.asarray(known & (log_odds > self.info.occupied_log_odds))
        with np.errstate(divide="ignore"):
            least = np.log(min_probability) - np.log1p(-min_probability)
        return np.asarray(known & (log_odds >= least))

    def _log_odds(self, cells: NDArray[np.int8]) -> NDArray[np.float32]:
        """Return quantised log-odds; of classes, values one step beyond their thresholds."""
        info = self.info
        if self.interest.detail != "classes":
            return cells * np.float32(info.log_odds_step)
        middle = (info.free_log_odds + info.occupied_log_odds) / 2
        low = info.free_log_odds - info.log_odds_step
        high = info.occupied_log_odds + info.log_odds_step
        values = np.array([low, middle, high], np.float32)
        return np.asarray(values[np.clip(cells, -1, 1).astype(np.intp) + 1])


MAX_LOG_ODDS = 127.0
"""Largest log-odds of any map."""


def map_of(
    cells: Cells, cell_m: float, info: MapInfo, config: "Config | None" = None
) -> "SonarMap":
    """Make a map of cells: each becomes a voxel with its quantised log-odds, observed once.

    Args:
        cells: known cells.
        cell_m: edge of a cell, which may be several voxels of the daemon's map.
        info: of the daemon's map.
        config: settings of the daemon, as far as known; grid, thresholds and clamps are taken from
            the cells.
    """
    # Imported here: other uses of a client need neither the settings nor the core.
    from mapperd.config.tree import Config  # noqa: PLC0415
    from mapperd.mapping.sonar_map import SonarMap  # noqa: PLC0415

    config = config or Config()
    # Rounding to steps may exceed the clamps of the daemon's map.
    most = min(float(np.abs(cells.log_odds).max(initial=0.0)), MAX_LOG_ODDS)
    replace = msgspec.structs.replace
    limits = {
        "occupied_threshold": _probability(info.occupied_log_odds),
        "free_threshold": _probability(info.free_log_odds),
    }
    config = replace(config, octree=replace(config.octree, voxel_resolution=cell_m))
    if info.prior_log_odds:
        prior, most = info.prior_log_odds, min(most, MAX_LOG_ODDS + info.prior_log_odds)
        arc = replace(
            config.arc,
            prior=_probability(prior),
            lowest=min(config.arc.lowest, prior - 1, -most),
            highest=max(config.arc.highest, most),
            **limits,
        )
        config = replace(config, mapping=replace(config.mapping, rule="arc"), arc=arc)
    else:
        config = replace(
            config,
            mapping=replace(config.mapping, rule="iwlo", **limits),
            iwlo=replace(
                config.iwlo,
                L_min=min(config.iwlo.L_min, -most),
                L_max=max(config.iwlo.L_max, most),
            ),
        )
    sonar_map = SonarMap(config)
    sonar_map.core.set_log_odds(cells.centres_m, cells.log_odds.astype(np.float64))
    return sonar_map


def _probability(log_odds: float) -> float:
    """Return the probability of log-odds, strictly between 0 and 1 as thresholds must be."""
    odds = math.exp(-abs(log_odds))
    p = odds / (1 + odds) if log_odds < 0 else 1 / (1 + odds)
    return min(max(p, math.ulp(0.0)), math.nextafter(1.0, 0.0))
