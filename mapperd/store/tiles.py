"""Tiles in memory, and bricks as rows of the file."""

import itertools
import sqlite3
import struct
import zlib
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import zstandard

from mapperd import _core

__all__ = [
    "COLUMNS",
    "LAYERS",
    "BrickRow",
    "DamagedBrickError",
    "Key",
    "ResidentTiles",
    "check_row",
    "layer_of",
    "pack",
    "rows_of",
    "rows_of_tile",
    "unpack",
]

Key = tuple[int, int, int]

LEVEL = 1
"""Level of zstd; level 3 makes rows of a seabed 6 % smaller and takes 20 % longer."""

MAX_BYTES = 1 + (_core.BRICK_VOXELS // _core.BLOCK_EDGE) ** 3 * (
    1 + 8 + 1 + _core.BLOCK_EDGE**3 // 8 + _core.BLOCK_EDGE**3 * 6
)
"""Maximum size of a brick: all voxels observed, in form 2 of
cpp/map/include/mapperd/map/block_codec.hpp. Forms 3 to 5 are smaller."""

LAYERS = _core.BRICK_VOXELS // _core.BLOCK_EDGE
"""Layers of blocks in a brick."""

BLOCK_HEADER_BYTES = 1 + 8
"""Size of the position in the brick and the revision."""

CELL_VOXELS = 64

COLUMNS = "x, y, z, revision, size, crc, data"


class DamagedBrickError(Exception):
    """A row is damaged; the text states how."""


@dataclass(frozen=True, slots=True)
class BrickRow:
    """A row of the table `brick`.

    Attributes:
        key: key of the brick.
        revision: revision of the map at the brick's last change.
        size: size of the brick's bytes.
        crc: CRC-32 of key, revision, size and data.
        data: the bytes, as one zstd frame.
    """

    key: Key
    revision: int
    size: int
    crc: int
    data: bytes


def pack(compressor: zstandard.ZstdCompressor, key: Key, revision: int, brick: bytes) -> BrickRow:
    """Make a brick's row."""
    data = compressor.compress(brick)
    return BrickRow(key, revision, len(brick), _crc(key, revision, len(brick), data), data)


def check_row(row: BrickRow) -> None:
    """Verify a row's checksum without decompressing its data.

    Raises:
        DamagedBrickError: the row is not as it was written.
    """
    values = (*row.key, row.revision, row.size, row.crc)
    if not all(isinstance(value, int) for value in values) or not isinstance(row.data, bytes):
        raise DamagedBrickError("columns of another type")
    if not (0 < row.size <= MAX_BYTES and 0 <= row.revision < 1 << 63):
        raise DamagedBrickError("a size or a revision that no brick has")
    if _crc(row.key, row.revision, row.size, row.data) != row.crc:
        raise DamagedBrickError("the checksum is wrong")


def unpack(decompressor: zstandard.ZstdDecompressor, row: BrickRow) -> bytes:
    """Decode the brick of a row.

    Raises:
        DamagedBrickError: the row is not as it was written.
    """
    check_row(row)
    try:
        brick = decompressor.decompress(row.data, max_output_size=row.size)
    except zstandard.ZstdError as error:
        raise DamagedBrickError(f"cannot be decompressed: {error}") from error
    if len(brick) != row.size:
        raise DamagedBrickError("shorter than its header states")
    return brick


def layer_of(brick: bytes, layer: int) -> bytes:
    """Return a brick's bytes with the blocks of one layer only.

    Args:
        brick: as the core encodes it, see cpp/map/include/mapperd/map/brick.hpp.
        layer: index of the blocks along x, below `LAYERS`.

    Raises:
        ValueError: the bytes are not a brick's.
    """
    kept = [b""]
    at = 1
    for _ in range(brick[0]):
        end = at + BLOCK_HEADER_BYTES + _block_bytes(brick, at + BLOCK_HEADER_BYTES)
        if end > len(brick):
            raise ValueError("a brick that ends too early")
        if brick[at] % LAYERS == layer:
            kept.append(brick[at:end])
        at = end
    return bytes([len(kept) - 1]) + b"".join(kept)


def _block_bytes(brick: bytes, at: int) -> int:
    """Return the length of a block's voxels; see cpp/map/include/mapperd/map/block_codec.hpp."""
    voxels = _core.BLOCK_EDGE**3
    match brick[at : at + 1]:
        case b"\1":
            return 7
        case b"\2":
            observed = int.from_bytes(brick[at + 1 : at + 1 + voxels // 8], "little")
            return 1 + voxels // 8 + 6 * observed.bit_count()
        case b"\3":
            return 6
        case b"\4" | b"\5":
            alike = int.from_bytes(brick[at + 2 : at + 10], "little").bit_count()
            mixed = int.from_bytes(brick[at + 10 : at + 18], "little").bit_count()
            return 18 + 4 * alike + CELL_VOXELS * (2 + brick[at] - 3) * mixed
        case _:
            raise ValueError("a block in a form that this version does not know")


def rows_of_tile(connection: sqlite3.Connection, tile: Key, edge: int) -> Iterator[BrickRow]:
    """Select the rows of a tile with an edge of `edge` bricks."""
    (x, y, z) = (edge * i for i in tile)
    for brick_x, brick_y in itertools.product(range(x, x + edge), range(y, y + edge)):
        found = connection.execute(
            f"SELECT {COLUMNS} FROM brick WHERE x = ? AND y = ? AND z BETWEEN ? AND ?",  # noqa: S608 our own text
            (brick_x, brick_y, z, z + edge - 1),
        )
        yield from rows_of(found)


def rows_of(found: Iterable[Sequence[Any]]) -> Iterator[BrickRow]:
    """Return the rows of a SELECT of COLUMNS."""
    for x, y, z, revision, size, crc, data in found:
        yield BrickRow((x, y, z), revision, size, crc, data)


def _crc(key: Key, revision: int, size: int, data: bytes) -> int:
    return zlib.crc32(data, zlib.crc32(struct.pack("<3qQQ", *key, revision, size)))


class ResidentTiles:
    """The tiles in memory, least recently used first.

    Args:
        limit: target number; one ping may need more at once.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._used_at: OrderedDict[Key, int] = OrderedDict()

    def __len__(self) -> int:
        return len(self._used_at)

    def all(self) -> list[Key]:
        """Return all tiles, least recently used first."""
        return list(self._used_at)

    def missing(self, tiles: Sequence[Key]) -> list[Key]:
        """Return the tiles that are not in memory."""
        return [tile for tile in tiles if tile not in self._used_at]

    def use(self, tiles: Iterable[Key], revision: int) -> None:
        """Note that tiles are in memory and change at the next revision."""
        for tile in tiles:
            self._used_at[tile] = revision
            self._used_at.move_to_end(tile)

    def surplus(self, coming: int, needed: Collection[Key]) -> list[Key]:
        """Return the tiles to evict so that `coming` more fit; none that is needed."""
        too_many = len(self._used_at) + coming - self._limit
        spare = [tile for tile in self._used_at if tile not in needed]
        return spare[: max(too_many, 0)]

    def changed_since(self, revision: int, tiles: Iterable[Key]) -> set[Key]:
        """Return the tiles that may have changed after a revision."""
        return {tile for tile in tiles if self._used_at[tile] >= revision}

    def drop(self, tiles: Iterable[Key]) -> None:
        """Note that tiles were evicted."""
        for tile in tiles:
            del self._used_at[tile]
