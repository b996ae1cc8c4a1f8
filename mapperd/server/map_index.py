"""The blocks of the map as one level and detail tell them, and when each changed last."""

import weakref
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.server.region import distances_m
from mapperd.server.stored_bricks import StoredBricks
from mapperd.wire.messages import BLOCK_EDGE, Vector

__all__ = ["Listener", "View", "batches", "bricks_of"]

CORE_BLOCKS_AT_ONCE = 256
"""Blocks of the map that are looked at under one lock of it: some milliseconds at most."""

BRICK_LEVEL = 3
"""A block of this level is a brick of the map's file; one of a lower level lies within one."""

FARTHEST = 1 << 30
"""Keys of the stream stay within: those of blocks beyond are told to nobody."""

Keys = NDArray[np.int32]
Numbers = NDArray[np.int64]
Revisions = NDArray[np.uint64]


DOUBT = np.uint64(0xD0B7_D0B7_D0B7_D0B7)
"""Digest of a block that was told as it was at no look: it differs from all that looks find."""


class Listener(Protocol):
    """Who is told which blocks changed."""

    def changed(self, numbers: Numbers) -> None:
        """These blocks are told otherwise than before."""


class View:
    """An index of blocks, numbered in the order in which they came to be known.

    Args:
        level: of the blocks.
        core_view: how they are told.
        resolution_m: of the map.

    Attributes:
        level, core: as given.
        block_m: edge of a block.
        digests, revisions: (>= N,) of each block: what was told of it last, and since when.
        looked: revision up to which the map was looked at.
        in_file: revision up to which the file was.
        sure: revision up to which all changes in memory are indexed.
        settled: revision up to which all changes are indexed; None before that was ever so.
        listeners: are told of changes.
        unused_since_ns: nobody listens since then; None while somebody does.
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
        self.listeners: weakref.WeakSet[Listener] = weakref.WeakSet()
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
        """Of the index."""
        return self._index.memory_bytes + self.digests.nbytes + self.revisions.nbytes

    def keys(self, numbers: Numbers) -> Keys:
        """Keys (N, 3) of blocks."""
        return self._index.keys(numbers)

    def note_blocks(self, blocks: Keys) -> None:
        """Blocks of the map (N, 3) in memory changed."""
        self._waiting = np.concatenate([self._waiting, _stream_keys(blocks, self.level)])

    def note_bricks(self, bricks: Keys, revision: int | None) -> None:
        """Bricks that are in the file alone changed, at this revision; None is as they say."""
        for brick in bricks.tolist():
            self._bricks[tuple(brick)] = revision

    def doubt(self, numbers: Numbers, core: _core.VoxelMap) -> None:
        """Blocks were told as they are now, which may be newer than what is indexed of them.

        They may be indexed next as what they were before: what was told is wrong then, though
        nothing seems to have changed. So those that changed since are taken for others.
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
            # They left while we were about to look: whoever saw them change is told from the file.
            self.note_bricks(bricks_of(keys[part][~here], self.level), self.looked)

    def work_on_file(
        self, files: StoredBricks, position_m: Vector | None, most_bricks: int
    ) -> None:
        """Index what is in the file alone, nearest to the vehicle first.

        Raises:
            StoreError: it cannot be read; what is not indexed stays to be.
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
        """Note what is told of blocks now, and tell whoever listens which ones differ."""
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
    """Slices of blocks of a level that are looked at under one lock."""
    each = CORE_BLOCKS_AT_ONCE * 8 if level == 0 else CORE_BLOCKS_AT_ONCE >> 3 * (level - 1)
    for begin in range(0, blocks, each):
        yield slice(begin, begin + each)


def bricks_of(keys: Keys, level: int) -> Keys:
    """The bricks (N, 3) in which blocks of a level lie."""
    bricks: Keys = keys >> np.int32(BRICK_LEVEL - level)
    return bricks


def _stream_keys(blocks: Keys, level: int) -> Keys:
    """The blocks (M, 3) of the stream that blocks of the map (N, 3) are in."""
    if level == 0:
        eighths = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)
        keys = (2 * blocks.astype(np.int64)[:, None] + eighths).reshape(-1, 3)
    else:
        keys = blocks.astype(np.int64) >> (level - 1)
    near: Keys = keys[(np.abs(keys) < FARTHEST).all(axis=1)].astype(np.int32)
    if level <= 1:
        return near
    each_once = _core.KeyIndex()
    each_once.numbers(near, add=True)
    return each_once.keys(np.arange(len(each_once), dtype=np.int64))
