"""Writes OctoMap trees brick by brick.

A brick is a node ten levels below the root of the tree. The file is depth first, so the trees of
the bricks follow in Morton order. Records of nodes above them are reserved and filled in when
their children are known.
"""

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd import _core

__all__ = ["Subtree", "TreeFile", "brick_paths", "subtree_in"]

BRICK_DEPTH = 16 - (_core.BRICK_VOXELS.bit_length() - 1)
"""Levels from the root down to a brick."""

KEY_ORIGIN = 32768 // _core.BRICK_VOXELS
"""Key of brick 0 in the tree, along each axis."""

SIZE = re.compile(rb"^size (\d+)$", re.MULTILINE)
DATA = b"\ndata\n"

INNER = 3
"""Bits of a child in a record of a `.bt`: 0 unknown, 1 free, 2 occupied, 3 with children."""

CHILDREN = 8


@dataclass(frozen=True, slots=True)
class Subtree:
    """A node with its subtree.

    Attributes:
        data: records as in the file; none for a leaf of a `.bt`.
        nodes: number of nodes, including itself.
        value: in a `.ot` the maximum log-odds below; in a `.bt` the class of a leaf.
        is_leaf: whether it has no children.
    """

    data: bytes
    nodes: int
    value: float
    is_leaf: bool

    @property
    def kind(self) -> int:
        """Bits of the node in its parent's record in a `.bt`."""
        return int(self.value) if self.is_leaf else INNER


def brick_paths(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the paths (N,) from the root to bricks (N, 3), three bits a level.

    Bricks outside OctoMap's range have the path -1.
    """
    places = keys + KEY_ORIGIN
    inside = ((places >= 0) & (places < 2 * KEY_ORIGIN)).all(axis=1)
    paths = np.zeros(len(keys), dtype=np.int64)
    for bit in range(BRICK_DEPTH):
        for axis in range(3):
            paths |= ((places[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.where(inside, paths, -1)


def subtree_in(file: bytes, *, binary: bool) -> Subtree | None:
    """Extract a brick's tree from a file with nothing else; None if it is empty."""
    found = SIZE.search(file)
    nodes = 0 if found is None else int(found[1])
    if not nodes:
        return None
    record = 2 if binary else 5
    begin = file.index(DATA) + len(DATA) + BRICK_DEPTH * record
    data = file[begin:]
    if not binary:
        value, mask = struct.unpack_from("<fB", data)
        return Subtree(data, nodes - BRICK_DEPTH, value, mask == 0)
    (bits,) = struct.unpack_from("<H", file, begin - record)
    kind = next(child for child in (bits >> 2 * i & 3 for i in range(CHILDREN)) if child)
    return Subtree(data, nodes - BRICK_DEPTH, kind, kind != INNER)


class TreeFile:
    """Writes the records of a tree.

    Args:
        file: at its start; it must support seek and truncate.
        binary: write a `.bt`, otherwise a `.ot`.

    Attributes:
        nodes: number of nodes written.
    """

    def __init__(self, file: BinaryIO, *, binary: bool) -> None:
        self.nodes = 0
        self._file = file
        self._binary = binary

    def write(self, paths: Sequence[int], brick_at: Callable[[int], Subtree | None]) -> None:
        """Write the tree.

        Args:
            paths: paths of the bricks, ascending.
            brick_at: returns the tree of the brick at an index in `paths`; called in order.
        """
        if paths:
            self._node(paths, brick_at, 0, len(paths), 0)

    def _node(
        self,
        paths: Sequence[int],
        brick_at: Callable[[int], Subtree | None],
        begin: int,
        end: int,
        depth: int,
    ) -> Subtree | None:
        """Write the node over bricks [begin, end); nothing if they are empty."""
        if depth == BRICK_DEPTH:
            brick = brick_at(begin)
            if brick is not None:
                self._file.write(brick.data)
                self.nodes += brick.nodes
            return brick
        at, before = self._file.tell(), self.nodes
        self._file.write(b"\0" * (2 if self._binary else 5))
        self.nodes += 1
        shift = 3 * (BRICK_DEPTH - 1 - depth)
        children: list[Subtree | None] = []
        for number in range(CHILDREN):
            last = begin
            while last < end and paths[last] >> shift & 7 == number:
                last += 1
            child = self._node(paths, brick_at, begin, last, depth + 1) if last > begin else None
            children.append(child)
            begin = last
        return self._ended(at, before, children)

    def _ended(self, at: int, before: int, children: list[Subtree | None]) -> Subtree | None:
        """Fill in a node's record; a node of eight equal leaves becomes one, as in OctoMap."""
        known = [child for child in children if child is not None]
        equal = len(known) == CHILDREN and all(
            child.is_leaf and child.value == known[0].value for child in known
        )
        if not known or equal:
            self._file.seek(at)
            self._file.truncate()
            self.nodes = before
        if not known:
            return None
        if equal:
            self._file.write(known[0].data)
            self.nodes += 1
            return known[0]
        value = max(child.value for child in known)
        self._file.seek(at)
        self._file.write(self._record(children, value))
        self._file.seek(0, 2)
        return Subtree(b"", 0, value, is_leaf=False)

    def _record(self, children: list[Subtree | None], value: float) -> bytes:
        if self._binary:
            kinds = (
                0 if one is None else int(one.value) if one.is_leaf else INNER for one in children
            )
            return struct.pack("<H", sum(kind << 2 * i for i, kind in enumerate(kinds)))
        mask = sum(1 << i for i, child in enumerate(children) if child is not None)
        return struct.pack("<fB", value, mask)
