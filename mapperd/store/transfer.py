"""Save the map's bricks to the file, and load them."""

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import zstandard

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.store.database import reading, transaction, translated
from mapperd.store.metadata import Identity, renewed
from mapperd.store.tiles import (
    COLUMNS,
    LEVEL,
    BrickRow,
    DamagedBrickError,
    Key,
    pack,
    rows_of,
    rows_of_tile,
    unpack,
)

__all__ = ["Loader", "Position", "Saver", "Snapshot"]

Position = bytes | Callable[[], bytes]
"""A place in the input, or what makes it when it is written."""

PUT = f"""INSERT INTO brick ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (x, y, z) DO UPDATE SET
    revision = excluded.revision, size = excluded.size, crc = excluded.crc, data = excluded.data"""  # noqa: S608 our own text

PROGRESS = """INSERT INTO progress VALUES (1, ?, ?)
    ON CONFLICT (id) DO UPDATE SET revision = excluded.revision, position = excluded.position"""

QUARANTINE = f"""INSERT INTO quarantine ({COLUMNS}, reason)
    SELECT {COLUMNS}, ? FROM brick WHERE x = ? AND y = ? AND z = ?"""  # noqa: S608 our own text

REBUILT = """UPDATE quarantine SET rebuilt = 1, data = NULL WHERE x = ? AND y = ? AND z = ?"""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What changed since an older state, all of one moment between two pings.

    Attributes:
        number: of the snapshot; later ones have higher numbers.
        revision: of the map.
        position: in the input, up to which the map is complete; or what makes it.
        bricks: (key, revision, bytes) of those that changed.
        damaged: bricks whose rows could not be read, and why.
        rebuilt: bricks of quarantined rows that are whole again.
    """

    number: int
    revision: int
    position: Position
    bricks: Iterable[tuple[Key, int, bytes]]
    damaged: Mapping[Key, str]
    rebuilt: tuple[Key, ...] = ()


class Saver:
    """Writes snapshots.

    Args:
        connection: to the file; used by one thread at a time.

    Attributes:
        bricks_written: rows written.
        bytes_written: of their data.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.bricks_written = 0
        self.bytes_written = 0

    def write(self, snapshot: Snapshot) -> None:
        """All of it, or nothing.

        Raises:
            sqlite3.Error: it cannot be; the file is as before.
        """
        rows = sizes = 0
        with transaction(self._connection):
            for key, reason in snapshot.damaged.items():
                self._connection.execute(QUARANTINE, (reason, *key))
                self._connection.execute("DELETE FROM brick WHERE (x, y, z) = (?, ?, ?)", key)
            for row in self._packed(snapshot):
                self._connection.execute(PUT, (*row.key, row.revision, row.size, row.crc, row.data))
                rows, sizes = rows + 1, sizes + len(row.data)
            self._connection.executemany(REBUILT, snapshot.rebuilt)
            self._connection.execute(PROGRESS, (snapshot.revision, snapshot.position))
        self.bricks_written += rows
        self.bytes_written += sizes

    def forget(self, revision: int, position: bytes, identity: Identity) -> Identity:
        """Empty the map; nothing is lost any more, for nothing should be there.

        Returns:
            the identity of the map from now on.

        Raises:
            sqlite3.Error: it cannot be; the file is as before.
        """
        with transaction(self._connection):
            self._connection.execute("DELETE FROM brick")
            self._connection.execute("UPDATE quarantine SET rebuilt = 1, data = NULL")
            self._connection.execute(PROGRESS, (revision, position))
            return renewed(self._connection, identity)

    def _packed(self, snapshot: Snapshot) -> Iterator[BrickRow]:
        for key, revision, brick in snapshot.bricks:
            yield pack(self._compressor, key, revision, brick)


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
