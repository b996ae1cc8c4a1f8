"""Blocks of the map by level, region and time of change, in memory and on disk."""

import weakref
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import zstandard
from numpy.typing import ArrayLike, NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.mapping.core_args import rule_params
from mapperd.store.database import open_reader, reading, translated
from mapperd.store.metadata import lost_in
from mapperd.store.tiles import COLUMNS, BrickRow, DamagedBrickError, Key, rows_of, unpack
from mapperd.wire.messages import BLOCK_EDGE, Interest, Vector

__all__ = [
    "LEAVE",
    "BlockIndex",
    "ChangeListener",
    "ChangedRows",
    "StoredBricks",
    "batches",
    "bricks_of",
    "distances_m",
    "in_box",
    "vector_of",
    "within",
]

LEAVE = 1.1
"""A sent block is removed beyond this many times the radius: blocks at its edge do not flicker."""


DISTANCES_AT_ONCE = 1 << 14
"""Blocks whose distances are computed at once; each takes 100 bytes meanwhile."""


def vector_of(position_m: ArrayLike | None) -> Vector | None:
    """Convert a position (3,) to floats."""
    if position_m is None:
        return None
    x, y, z = np.asarray(position_m, float).tolist()
    return x, y, z


def distances_m(keys: NDArray[np.int32], block_m: float, position_m: Vector) -> NDArray[np.float64]:
    """Return the distance of a point to the nearest point of each block (N,), metres.

    Args:
        keys: (N, 3).
        block_m: edge of a block.
        position_m: map frame.
    """
    found = np.empty(len(keys))
    for begin in range(0, len(keys), DISTANCES_AT_ONCE):
        part = slice(begin, begin + DISTANCES_AT_ONCE)
        away = np.abs((keys[part] + 0.5) * block_m - np.asarray(position_m)) - block_m / 2
        found[part] = np.linalg.norm(np.maximum(away, 0.0), axis=1)
    return found


def in_box(keys: NDArray[np.int32], block_m: float, interest: Interest) -> NDArray[np.bool_]:
    """Return which blocks (N,) have a part inside the box of an interest."""
    if interest.box is None:
        return np.ones(len(keys), bool)
    low = keys * float(block_m)
    touching = (low < interest.box.high_m) & (low + block_m > interest.box.low_m)
    inside: NDArray[np.bool_] = np.all(touching, axis=1)
    return inside


def within(
    keys: NDArray[np.int32],
    block_m: float,
    interest: Interest,
    position_m: Vector | None,
    held: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Return which blocks (N,) a client gets.

    Args:
        keys: (N, 3).
        block_m: edge of a block.
        interest: of the client.
        position_m: of the vehicle; None if unknown: then no new blocks lie within the radius.
        held: (N,) blocks that were sent: they are removed at a larger radius.
    """
    inside = in_box(keys, block_m, interest)
    if interest.radius_m == 0:
        return inside
    if position_m is None:
        return inside & held
    limit = np.where(held, LEAVE * interest.radius_m, interest.radius_m)
    return inside & (distances_m(keys, block_m, position_m) <= limit)


MAX_BRICK = 1 << 27
"""Limit of a brick's key: larger keys are of damaged rows."""


@dataclass(frozen=True, slots=True, eq=False)
class ChangedRows:
    """Bricks of the file that changed after a revision.

    Attributes:
        keys: (N, 3) int32.
        revisions: (N,) int64, of each.
        revision: of the map in the file.
    """

    keys: NDArray[np.int32]
    revisions: NDArray[np.int64]
    revision: int


class StoredBricks:
    """Reads bricks from the map's file; used in one thread only.

    Args:
        path: of the file.
        config: settings of the map.

    Raises:
        StoreError: the file cannot be opened.

    Attributes:
        damaged: keys of the bricks that were found damaged.
        quarantined: keys of the bricks that the file's writer found damaged, as of the last look
            for changes.
    """

    def __init__(self, path: Path, config: Config) -> None:
        self.damaged: set[Key] = set()
        self.quarantined: frozenset[Key] = frozenset()
        self._path = path
        self._unpacker = zstandard.ZstdDecompressor()
        self._scratch = _core.VoxelMap(config.octree.voxel_resolution, rule_params(config))
        with ExitStack() as opening:
            self._connection = open_reader(path)
            opening.callback(self._connection.close)
            self._open = opening.pop_all()

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def version(self) -> int:
        """Return a number that changes with each write to the file.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self._path):
            return int(self._connection.execute("PRAGMA data_version").fetchone()[0])

    def changed_since(self, revision: int) -> ChangedRows:
        """Return the bricks whose rows changed after a revision.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self._path), reading(self._connection):
            progress = self._connection.execute("SELECT revision FROM progress").fetchone()
            found = self._connection.execute(
                "SELECT x, y, z, revision FROM brick WHERE revision > ?1 AND"
                " x BETWEEN -?2 AND ?2 AND y BETWEEN -?2 AND ?2 AND z BETWEEN -?2 AND ?2",
                (revision, MAX_BRICK),
            ).fetchall()
            self.quarantined = frozenset(lost_in(self._connection, self._path))
        columns = np.array(found, np.int64).reshape(-1, 4)
        return ChangedRows(
            columns[:, :3].astype(np.int32),
            columns[:, 3],
            int(progress[0]) if progress is not None else 0,
        )

    def has_losses(self) -> bool:
        """Return whether damaged bricks of the map were lost.

        Raises:
            StoreError: the file cannot be read.
        """
        with translated(self._path):
            lost = "SELECT EXISTS (SELECT 1 FROM quarantine WHERE NOT rebuilt)"
            return bool(self._connection.execute(lost).fetchone()[0])

    def load(self, bricks: NDArray[np.int32]) -> tuple[_core.VoxelMap, dict[Key, int]]:
        """Load a map of some bricks, valid until the next call.

        Args:
            bricks: keys (N, 3); bricks that are missing or damaged in the file are unknown.

        Returns:
            the map; the revision of each brick's row.

        Raises:
            StoreError: the file cannot be read.
        """
        self._scratch.clear()
        rows: list[BrickRow] = []
        with translated(self._path), reading(self._connection):
            for key in bricks.tolist():
                rows += rows_of(
                    self._connection.execute(
                        f"SELECT {COLUMNS} FROM brick WHERE x = ? AND y = ? AND z = ?",  # noqa: S608 our own text
                        key,
                    )
                )
        revisions = {}
        for row in rows:
            try:
                self._scratch.put_bricks([(row.key, unpack(self._unpacker, row))])
            except (DamagedBrickError, ValueError):
                self.damaged.add(row.key)
                continue
            self.damaged.discard(row.key)
            revisions[row.key] = row.revision
        return self._scratch, revisions


CORE_BLOCKS_AT_ONCE = 256
"""Blocks of the map to read under one lock: some milliseconds at most."""

BRICK_LEVEL = 3
"""Level whose blocks are the bricks of the map's file."""

MAX_KEY = 1 << 30
"""Limit of the keys of the stream; blocks beyond are not sent."""

Keys = NDArray[np.int32]
Numbers = NDArray[np.int64]
Revisions = NDArray[np.uint64]


DOUBT = np.uint64(0xD0B7_D0B7_D0B7_D0B7)
"""Digest of a block that was sent in a state of no look; it differs from every real digest."""


class ChangeListener(Protocol):
    """Gets the changed blocks of an index."""

    def changed(self, numbers: Numbers) -> None:
        """Note that blocks (N,) changed."""


class BlockIndex:
    """An index of blocks of one level, numbered in the order in which they are found.

    Args:
        level: of the blocks.
        core_view: level and detail, as the core takes them.
        resolution_m: of the map.

    Attributes:
        level, core: as given.
        block_m: edge of a block.
        digests, revisions: (>= N,) content of each block, and revision of its last change.
        looked: revision of the last look at the map in memory.
        in_file: revision of the last look at the file.
        sure: revision up to which all changes in memory are indexed.
        settled: revision up to which all changes are indexed; None before the first time.
        listeners: get the changed blocks.
        unused_since_ns: Unix time since which nobody listens; None while somebody does.
    """

    def __init__(self, level: int, core_view: _core.StreamView, resolution_m: float) -> None:
        self.level = level
        self.core = core_view
        self.block_m = resolution_m * BLOCK_EDGE * 2**level
        self.digests = np.zeros(0, np.uint64)
        self.revisions = np.zeros(0, np.uint64)
        self.looked = self.sure = 0
        self.in_file = -1
        self.settled: int | None = None
        self.listeners: weakref.WeakSet[ChangeListener] = weakref.WeakSet()
        self.unused_since_ns: int | None = None
        self._index = _core.KeyIndex()
        self._waiting = np.zeros((0, 3), np.int32)
        self._bricks: dict[tuple[int, int, int], int | None] = {}

    def __len__(self) -> int:
        """Blocks that have a number."""
        return len(self._index)

    @property
    def left(self) -> int:
        """Blocks in memory, and bricks in the file, that are still to be indexed."""
        return len(self._waiting) + len(self._bricks)

    @property
    def memory_bytes(self) -> int:
        """Memory of the index."""
        return self._index.memory_bytes + self.digests.nbytes + self.revisions.nbytes

    def keys(self, numbers: Numbers) -> Keys:
        """Return the keys (N, 3) of block numbers (N,)."""
        return self._index.keys(numbers)

    def note_blocks(self, blocks: Keys) -> None:
        """Note changed blocks of the map (N, 3) in memory, to be indexed by `work`."""
        self._waiting = np.concatenate([self._waiting, _stream_keys(blocks, self.level)])

    def note_bricks(self, bricks: Keys, revision: int | None) -> None:
        """Note changed bricks that are only in the file, to be indexed by `work_on_file`.

        Args:
            bricks: keys (N, 3).
            revision: of the change; None takes the revisions of the rows.
        """
        for brick in bricks.tolist():
            self._bricks[tuple(brick)] = revision

    def doubt(self, numbers: Numbers, core: _core.VoxelMap) -> None:
        """Mark blocks that were sent in a newer state than the indexed one.

        The next look may find such a block in its indexed state again. It would then seem
        unchanged, although the client has another state. `DOUBT` makes it differ.
        """
        for part in batches(len(numbers), self.level):
            some = numbers[part]
            _, revisions, here = core.stream_digests(self.core, self.keys(some))
            self.digests[some[(revisions > self.sure) | ~here]] = DOUBT

    def work(self, core: _core.VoxelMap, position_m: Vector | None, most_blocks: int) -> None:
        """Index what is in memory, nearest to the vehicle first."""
        keys, later = self._waiting, self._waiting[:0]
        if len(keys) > most_blocks:
            away_m = distances_m(keys, self.block_m, position_m or (0.0, 0.0, 0.0))
            order = np.argpartition(away_m, most_blocks)
            keys, later = keys[order[:most_blocks]], keys[order[most_blocks:]]
        self._waiting = later
        if not len(later):
            self.sure = self.looked
        for part in batches(len(keys), self.level):
            digests, revisions, here = core.stream_digests(self.core, keys[part])
            self._settle(keys[part][here], digests[here], revisions[here])
            # These blocks left memory before they were read: the file has their changes.
            self.note_bricks(bricks_of(keys[part][~here], self.level), self.looked)

    def work_on_file(
        self, files: StoredBricks, position_m: Vector | None, most_bricks: int
    ) -> None:
        """Index what is in the file alone, nearest to the vehicle first.

        Raises:
            StoreError: the file cannot be read; the bricks stay to be indexed.
        """
        if not self._bricks:
            return
        bricks = np.array(list(self._bricks), np.int32)
        brick_m = self.block_m * 2 ** (BRICK_LEVEL - self.level)
        away_m = distances_m(bricks, brick_m, position_m or (0.0, 0.0, 0.0))
        bricks = bricks[np.argsort(away_m, kind="stable")[:most_bricks]]
        found, row_revisions = files.load(bricks)
        _, _, blocks, _, _ = found.changed_blocks(0, bricks[:0])
        keys = _stream_keys(blocks, self.level)
        digests, revisions, _ = found.stream_digests(self.core, keys)
        holding = bricks_of(keys, self.level)
        for brick in map(tuple, bricks.tolist()):
            inside = (holding == brick).all(axis=1)
            at = self._bricks.pop(brick)
            newest = int(revisions[inside].max(initial=0))
            if at is None and row_revisions.get(brick, 0) > newest:
                at = row_revisions[brick]  # put into the file later than its blocks were mapped
            if at is not None:
                revisions[inside] = at
        self._settle(keys, digests, revisions)

    def _settle(self, keys: Keys, digests: Revisions, revisions: Revisions) -> None:
        """Index blocks, and pass those that differ to the listeners."""
        of_use = (self._index.numbers(keys, add=False) >= 0) | (digests != 0)
        numbers = self._index.numbers(keys[of_use], add=True)
        self._make_room()
        differ = self.digests[numbers] != digests[of_use]
        numbers = numbers[differ]
        self.digests[numbers] = digests[of_use][differ]
        self.revisions[numbers] = revisions[of_use][differ]
        if len(numbers):
            for listener in self.listeners:
                listener.changed(numbers)

    def _make_room(self) -> None:
        held, needed = len(self.digests), len(self._index)
        if needed > held:
            more = np.zeros(max(needed, held + held // 4 + 1024) - held, np.uint64)
            self.digests = np.concatenate([self.digests, more])
            self.revisions = np.concatenate([self.revisions, more])


def batches(blocks: int, level: int) -> Iterator[slice]:
    """Return slices of blocks to read under one lock each."""
    each = CORE_BLOCKS_AT_ONCE * 8 if level == 0 else CORE_BLOCKS_AT_ONCE >> 3 * (level - 1)
    for begin in range(0, blocks, each):
        yield slice(begin, begin + each)


def bricks_of(keys: Keys, level: int) -> Keys:
    """Return the bricks (N, 3) that contain blocks of a level."""
    bricks: Keys = keys >> np.int32(BRICK_LEVEL - level)
    return bricks


def _stream_keys(blocks: Keys, level: int) -> Keys:
    """Return the blocks (M, 3) of the stream that contain blocks of the map (N, 3)."""
    if level == 0:
        eighths = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)
        keys = (2 * blocks.astype(np.int64)[:, None] + eighths).reshape(-1, 3)
    else:
        keys = blocks.astype(np.int64) >> (level - 1)
    near: Keys = keys[(np.abs(keys) < MAX_KEY).all(axis=1)].astype(np.int32)
    if level <= 1:
        return near
    each_once = _core.KeyIndex()
    each_once.numbers(near, add=True)
    return each_once.keys(np.arange(len(each_once), dtype=np.int64))
