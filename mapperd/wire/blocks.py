"""Bodies of messages as arrays: blocks of cells in one zstd frame, and paths.

A block is a cube of 8 x 8 x 8 cells, a cell a cube of 2**level voxels along an edge. Block (x, y,
z) begins at 8 * 2**level * (x, y, z) voxels of the map's frame; its cells are in the order x
fastest, z slowest. Before compression, in little endian, N blocks are:

    uint32      N
    int32       x of every block, then y of every block, then z of every block
    uint32      age of every block: ms from its last change to the message's stamp, saturated
    uint8       kind of every block: 0 unknown, 1 all cells equal, 2 individual cells
    int8        the cell of every block of kind 1
    int8        the 512 cells of every block of kind 2
    uint8       with detail `counts`, the 512 counts of every block of kind 1 or 2

An unknown cell is -128. With detail `classes` it is -1 free, 0 neither, 1 occupied;
otherwise its log-odds in units of the map's `log_odds_step`, within +-127: the highest of its known
voxels. A count is the number of bits of the highest observation count of its voxels: 0 for none, 1
for 1, 2 for 2 and 3, 3 for 4 to 7, ...

Messages of the vehicle's path hold each coordinate as two float32: the rounded value and the
rounding error. The rounded values alone are off by up to half a metre if the map's zero is 4650 km
away, as in a survey's zone; readers that ignore the errors still get the path in the map frame.
"""

import threading
from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd.wire.framing import StreamError
from mapperd.wire.messages import BLOCK_EDGE, MAX_BLOCKS, PathMessage

__all__ = [
    "CELLS",
    "MAX_KEY",
    "SEEN_M",
    "UNKNOWN",
    "BlockSet",
    "decode_blocks",
    "encode_blocks",
    "path_message",
]

CELLS = BLOCK_EDGE**3
UNKNOWN = -128

EMPTY, UNIFORM, PLANE = 0, 1, 2

ROW_BYTES = 3 * 4 + 4 + 1
"""Bytes of a block without its cells."""

MAX_BODY = 4 + MAX_BLOCKS * (ROW_BYTES + 2 * CELLS)

MAX_KEY = 1 << 30
"""Limit of the absolute value of a key along each axis."""

LEVEL = 9
"""Level of zstd. Compared to 3, messages of the demo's dive are 13 % smaller and take five times as
long to encode: 0.5 ms per hundred blocks, once for all clients that keep up."""


class _Codecs(threading.local):
    """A compressor and a decompressor for each thread: two threads must not share one."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_CODECS = _Codecs()


@dataclass(frozen=True, slots=True, eq=False)
class BlockSet:
    """Some blocks of one level.

    Attributes:
        keys: (N, 3) int32.
        ages_ms: (N,) uint32.
        cells: (N, 512) int8.
        counts: (N, 512) uint8; None without counts.
    """

    keys: NDArray[np.int32]
    ages_ms: NDArray[np.uint32]
    cells: NDArray[np.int8]
    counts: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.keys)


def encode_blocks(blocks: BlockSet) -> bytes:
    """Encode the body of up to `MAX_BLOCKS` blocks."""
    cells = blocks.cells
    uniform = (cells == cells[:, :1]).all(axis=1)
    empty = uniform & (cells[:, 0] == UNKNOWN)
    kinds = np.where(empty, EMPTY, np.where(uniform, UNIFORM, PLANE)).astype(np.uint8)
    columns = [
        np.uint32(len(blocks)).astype("<u4"),
        np.ascontiguousarray(blocks.keys.T).astype("<i4"),
        blocks.ages_ms.astype("<u4"),
        kinds,
        cells[kinds == UNIFORM, 0],
        cells[kinds == PLANE],
    ]
    if blocks.counts is not None:
        columns.append(blocks.counts[kinds != EMPTY])
    return _CODECS.compressor.compress(b"".join(column.tobytes() for column in columns))


def decode_blocks(body: bytes, *, counts: bool) -> BlockSet:
    """Decode the blocks of a body.

    Args:
        body: of one message.
        counts: the body has counts.

    Raises:
        StreamError: the body is invalid (`bad_blocks`).
    """
    columns = _Columns(_unpacked(body))
    number = int(columns.take(1, "<u4")[0])
    if number > MAX_BLOCKS:
        raise StreamError(f"{number} blocks in a message; allowed: {MAX_BLOCKS}", "bad_blocks")
    keys = np.ascontiguousarray(columns.take(3 * number, "<i4").reshape(3, number).T)
    ages_ms = columns.take(number, "<u4")
    kinds = columns.take(number, "u1").astype(np.uint8)
    if (kinds > PLANE).any():
        raise StreamError("a block of an unknown kind", "bad_blocks")
    if number and max(int(keys.max()), -int(keys.min())) >= MAX_KEY:
        raise StreamError("a block beyond the map's reach", "bad_blocks")
    cells = np.full((number, CELLS), UNKNOWN, np.int8)
    uniform, plane = kinds == UNIFORM, kinds == PLANE
    cells[uniform] = columns.take(int(uniform.sum()), "i1")[:, None]
    cells[plane] = columns.take(int(plane.sum()) * CELLS, "i1").reshape(-1, CELLS)
    seen = None
    if counts:
        seen = np.zeros((number, CELLS), np.uint8)
        known = kinds != EMPTY
        seen[known] = columns.take(int(known.sum()) * CELLS, "u1").reshape(-1, CELLS)
    columns.end()
    return BlockSet(keys.astype(np.int32), ages_ms.astype(np.uint32), cells, seen)


class _Columns:
    """Reads arrays from bytes, one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, number: int, dtype: str) -> NDArray[np.generic]:
        kind = np.dtype(dtype)
        if len(self._data) - self._at < number * kind.itemsize:
            raise StreamError("blocks that are cut short", "bad_blocks")
        column = np.frombuffer(self._data, kind, number, self._at)
        self._at += number * kind.itemsize
        return column

    def end(self) -> None:
        if self._at != len(self._data):
            raise StreamError("bytes follow the last block", "bad_blocks")


def _unpacked(body: bytes) -> bytes:
    """Decompress a body, up to the largest valid size."""
    try:
        size = zstandard.frame_content_size(body)
        if not 0 <= size <= MAX_BODY:
            raise StreamError(f"blocks of {size} bytes; allowed: {MAX_BODY}", "bad_blocks")
        return _CODECS.decompressor.decompress(
            body, max_output_size=MAX_BODY, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise StreamError(f"blocks that cannot be unpacked: {error}", "bad_blocks") from error


SEEN_M = 1e-3
"""Smallest rounding error that is sent; within 32 km of the map's zero all are smaller."""


def path_message(first: int, points_m: NDArray[np.float64], version: int = 0) -> PathMessage:
    """Encode a piece of the path.

    Args:
        first: number of its first point.
        points_m: (N, 3), metres, map frame.
        version: of the numbering.
    """
    points = points_m.astype("<f4")
    rest = points_m - points
    has_rest = bool((np.abs(rest) >= SEEN_M).any())
    return PathMessage(
        first=first,
        points=points.tobytes(),
        version=version,
        rest=rest.astype("<f4").tobytes() if has_rest else b"",
    )
