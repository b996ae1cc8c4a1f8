"""Bricks out of the file, and what is damaged in it."""

import sqlite3
from collections.abc import Iterable
from pathlib import Path

import zstandard

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.store.bricks import (
    COLUMNS,
    BrickRow,
    DamagedBrickError,
    Key,
    rows_of,
    rows_of_tile,
    unpack,
)
from mapperd.store.database import reading, translated

__all__ = ["Loader"]


class Loader:
    """Reads tiles for the thread of the pings, while another may write.

    Args:
        connection: to read the file with.
        path: of the file.
        edge: of a tile, in bricks.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, edge: int) -> None:
        self._connection = connection
        self._path = path
        self._edge = edge
        self._unpacker = zstandard.ZstdDecompressor()

    def load(self, core: _core.VoxelMap, tiles: list[Key]) -> dict[Key, str]:
        """Make tiles resident as the file has them.

        Returns:
            bricks that are damaged in it, and how; they are empty now.

        Raises:
            StoreError: it cannot be read.
        """
        with translated(self._path), reading(self._connection):
            rows = [
                row for tile in tiles for row in rows_of_tile(self._connection, tile, self._edge)
            ]
        bricks, damaged = self._sound(rows)
        try:
            core.put_bricks(bricks, tiles)
        except ValueError:  # with a true checksum: written by somebody else
            core.put_bricks([], tiles)
            damaged |= _put_one_by_one(core, bricks)
        return damaged

    def damage(self) -> dict[Key, str]:
        """Read the whole file for damaged bricks.

        Raises:
            StoreError: it cannot be read, or its structure is damaged.
        """
        with translated(self._path), reading(self._connection):
            for (verdict,) in self._connection.execute("PRAGMA quick_check(1)"):
                if verdict != "ok":
                    raise StoreError(f"{self._path}: is damaged: {verdict}", "damaged")
            damaged: dict[Key, str] = {}
            found = self._connection.execute(f"SELECT {COLUMNS} FROM brick")  # noqa: S608 our own
            for row in rows_of(found):
                damaged |= self._sound([row])[1]
        return damaged

    def _sound(self, rows: Iterable[BrickRow]) -> tuple[list[tuple[Key, bytes]], dict[Key, str]]:
        """The bricks of rows that are as they were written, and what is wrong with the others."""
        bricks = []
        damaged = {}
        for row in rows:
            try:
                bricks.append((row.key, unpack(self._unpacker, row)))
            except DamagedBrickError as error:
                damaged[row.key] = str(error)
        return bricks, damaged


def _put_one_by_one(core: _core.VoxelMap, bricks: list[tuple[Key, bytes]]) -> dict[Key, str]:
    damaged = {}
    for brick in bricks:
        try:
            core.put_bricks([brick])
        except ValueError as error:
            damaged[brick[0]] = str(error)
    return damaged
