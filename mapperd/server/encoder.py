"""Encodes blocks as messages, once for all clients that get the same ones."""

from array import array
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.server.map_index import BlockIndex, StoredBricks, batches, bricks_of
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet, encode_blocks
from mapperd.wire.framing import framed
from mapperd.wire.messages import BlocksMessage

__all__ = ["BlockEncoder", "Body", "RevisionTimes"]

MAX_KEPT = 64
"""Bodies and messages of one look that are kept: clients that keep up share them."""

FIRST_GUESS = 64.0
"""Bytes per block."""

MAX_TIMES = 1 << 16

BRICKS_AT_ONCE = 32
"""Bricks to read from the file at a time; each may take 1.5 MB."""

Numbers = NDArray[np.int64]
Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Body:
    """Blocks as they were read from the map.

    Attributes:
        revision: of the map when they were read.
        number: of this body.
        data: body of a `BlocksMessage`.
    """

    revision: int
    number: int
    data: bytes


class RevisionTimes:
    """Times of the map's revisions, with less resolution for earlier ones."""

    def __init__(self) -> None:
        self._revisions, self._ns = array("Q"), array("q")

    def note(self, revision: int, now_ns: int) -> None:
        """Note the current revision."""
        if self._revisions and revision <= self._revisions[-1]:
            return
        if len(self._revisions) == MAX_TIMES:
            half = MAX_TIMES // 2
            self._revisions[:half] = self._revisions[:half:2]
            self._ns[:half] = self._ns[:half:2]
        self._revisions.append(revision)
        self._ns.append(now_ns)

    def of(self, revisions: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Return the Unix times (N,) when the map had reached the revisions (N,)."""
        at = np.searchsorted(np.array(self._revisions), revisions)
        return np.array(self._ns)[np.minimum(at, len(self._ns) - 1)]


class BlockEncoder:
    """Encodes blocks; used in one thread only.

    Args:
        core: the map.
        files: the bricks on disk; None if the whole map is in memory.
    """

    def __init__(self, core: _core.VoxelMap, files: StoredBricks | None) -> None:
        self.times = RevisionTimes()
        self._number = 0
        self._core = core
        self._files = files
        self._stamp_ns = 0
        self._guess: dict[tuple[int, str], float] = {}
        self._bodies: dict[tuple[object, ...], Body] = {}
        self._messages: dict[tuple[object, ...], BlocksMessage] = {}
        self._framed: dict[int, tuple[BlocksMessage, bytes]] = {}

    def begin(self, now_ns: int) -> None:
        """Discard all encoded bodies and messages: a new look at the map begins."""
        self._stamp_ns = now_ns
        self._bodies.clear()
        self._messages.clear()
        self._framed.clear()

    def blocks_in(self, most_bytes: int, level: int, detail: str) -> int:
        """Estimate how many blocks fill this many bytes; rounded, so that clients share bodies."""
        number = max(int(most_bytes / self._guess.get((level, detail), FIRST_GUESS)), 1)
        low = 1 << number.bit_length() - 1
        return low + low // 2 if number >= low + low // 2 else low

    def body(
        self,
        view: BlockIndex,
        detail: str,
        numbers: Numbers,
        wanted: NDArray[np.bool_],
        least_number: int = 0,
    ) -> Body:
        """Encode blocks as they are now, unwanted ones as empty.

        Args:
            view: index of the blocks.
            detail: of the interest.
            numbers: (N,) of the blocks.
            wanted: (N,) whether to send the content of each block.
            least_number: lowest number of a body to reuse; the client has newer blocks than those
                of earlier bodies.

        Raises:
            StoreError: the map's file cannot be read.
        """
        key = (id(view), detail, numbers.tobytes(), wanted.tobytes())
        known = self._bodies.get(key)
        if known is None or known.number < least_number:
            known = self._made(view, detail, numbers, wanted)
            _keep(self._bodies, key, known)
        return known

    def message(self, body: Body, left: int, complete: int | None) -> BlocksMessage:
        """Return a message; the same object for all clients that get the same one."""
        key = (body.number, left, complete)
        known = self._messages.get(key)
        if known is None:
            known = BlocksMessage(
                revision=body.revision,
                stamp_ns=self._stamp_ns,
                left=left,
                complete=complete,
                body=body.data,
            )
            _keep(self._messages, key, known)
        return known

    def framed(self, message: BlocksMessage) -> bytes:
        """Return a message as bytes of the wire, encoded once for each object."""
        known = self._framed.get(id(message))
        if known is None or known[0] is not message:
            known = message, framed(message)
            _keep(self._framed, id(message), known)
        return known[1]

    def _made(
        self, view: BlockIndex, detail: str, numbers: Numbers, wanted: NDArray[np.bool_]
    ) -> Body:
        self._number += 1
        keys = view.keys(numbers)
        cells = np.full((len(numbers), CELLS), UNKNOWN, np.int8)
        bits = np.zeros((len(numbers), CELLS), np.uint8)
        revision, cells[wanted], bits[wanted] = self._content(view, keys[wanted])
        if revision > view.sure:
            view.doubt(numbers[wanted], self._core)
        age_ns = self._stamp_ns - self.times.of(view.revisions[numbers])
        ages_ms = np.clip(age_ns // 1_000_000, 0, 2**32 - 1).astype(np.uint32)
        block_set = BlockSet(keys, ages_ms, cells, bits if detail == "counts" else None)
        body = encode_blocks(block_set)
        if len(numbers):
            before = self._guess.get((view.level, detail), FIRST_GUESS)
            share = min(len(numbers) / 256, 1.0) / 2
            self._guess[view.level, detail] = before + (len(body) / len(numbers) - before) * share
        return Body(revision, self._number, body)

    def _content(
        self, view: BlockIndex, keys: NDArray[np.int32]
    ) -> tuple[int, NDArray[np.int8], NDArray[np.uint8]]:
        cells = np.full((len(keys), CELLS), UNKNOWN, np.int8)
        bits = np.zeros((len(keys), CELLS), np.uint8)
        here = np.ones(len(keys), bool)
        revision = 0 if len(keys) else self._core.revision
        for part in batches(len(keys), view.level):
            now, cells[part], bits[part], here[part] = self._core.stream_blocks(
                view.core, keys[part]
            )
            revision = max(revision, now)
        if self._files is not None and not here.all():
            away = keys[~here]
            bricks = np.unique(bricks_of(away, view.level), axis=0)
            for begin in range(0, len(bricks), BRICKS_AT_ONCE):
                some = bricks[begin : begin + BRICKS_AT_ONCE]
                found, _ = self._files.load(some)
                holding = bricks_of(keys, view.level)
                these = ~here & (holding[:, None] == some).all(axis=2).any(axis=1)
                _, cells[these], bits[these], _ = found.stream_blocks(view.core, keys[these])
        return revision, cells, bits


def _keep(kept: dict[Key, Value], key: Key, value: Value) -> None:
    if len(kept) >= MAX_KEPT:
        del kept[next(iter(kept))]
    kept[key] = value
