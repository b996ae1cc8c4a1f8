"""Saves the map's bricks to the file and loads them."""

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import zstandard

from mapperd import _core
from mapperd.errors import StoreError
from mapperd.store.database import ADVICE, reading, transaction, translated
from mapperd.store.metadata import (
    MapIdentity,
    checksum_of,
    lost_crc,
    renewed,
    settings_crc,
)
from mapperd.store.tiles import (
    COLUMNS,
    LEVEL,
    BrickRow,
    DamagedBrickError,
    Key,
    check_row,
    pack,
    rows_of,
    rows_of_tile,
    unpack,
)

__all__ = ["Loader", "Position", "Saver", "Snapshot", "check_structure", "damaged_rows", "made"]

ROWS_AT_ONCE = 32
"""Rows that a check reads at once; each may take 1.5 MB."""

Position = bytes | Callable[[], bytes]
"""A position in the input, or a function that makes it when it is written."""


def made(position: Position) -> bytes:
    """Return the bytes of a position."""
    return position() if callable(position) else position


PUT = f"""INSERT INTO brick ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (x, y, z) DO UPDATE SET
    revision = excluded.revision, size = excluded.size, crc = excluded.crc, data = excluded.data"""  # noqa: S608 our own text

PROGRESS = """INSERT INTO progress (id, revision, position, checksum) VALUES (1, ?, ?, ?)
    ON CONFLICT (id) DO UPDATE SET revision = excluded.revision, position = excluded.position,
    checksum = excluded.checksum"""

QUARANTINE = f"""INSERT INTO quarantine ({COLUMNS}, reason)
    SELECT {COLUMNS}, ? FROM brick WHERE x = ? AND y = ? AND z = ?"""  # noqa: S608 our own text

UNSAVED = """INSERT INTO quarantine (x, y, z, reason)
    VALUES (?, ?, ?, 'there was no space to save it')"""

REBUILT = """UPDATE quarantine SET rebuilt = 1, data = NULL WHERE x = ? AND y = ? AND z = ?"""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Changes since an older state, taken between two pings.

    Attributes:
        number: number of the snapshot, increasing.
        revision: revision of the map.
        position: position in the input up to which the map is complete, or a function for it.
        bricks: (key, revision, bytes) of changed bricks.
        damaged: bricks whose rows could not be read, with the reason.
        rebuilt: bricks of quarantined rows that are complete again.
        unsaved: changed bricks that are not in `bricks`; the file loses them.
    """

    number: int
    revision: int
    position: Position
    bricks: Iterable[tuple[Key, int, bytes]]
    damaged: Mapping[Key, str]
    rebuilt: tuple[Key, ...] = ()
    unsaved: tuple[Key, ...] = ()


class Saver:
    """Writes snapshots.

    Args:
        connection: connection to the file, whose metadata are verified; one thread at a time.

    Raises:
        sqlite3.Error: the file cannot be read.

    Attributes:
        bricks_written: rows written.
        bricks_packed: rows started; increases during a write.
        bytes_written: bytes of their data.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)
        self._settings_crc, self._lost_crc = settings_crc(connection), lost_crc(connection)
        self.bricks_written = self.bricks_packed = 0
        self.bytes_written = 0

    def write(self, snapshot: Snapshot) -> None:
        """Write a snapshot in one transaction.

        Raises:
            sqlite3.Error: it fails; the file is unchanged.
        """
        rows = sizes = 0
        lost = self._lost_crc
        with transaction(self._connection):
            for key, reason in snapshot.damaged.items():
                self._connection.execute(QUARANTINE, (reason, *key))
                self._connection.execute("DELETE FROM brick WHERE (x, y, z) = (?, ?, ?)", key)
            self._connection.executemany(UNSAVED, snapshot.unsaved)
            self._connection.executemany(
                "DELETE FROM brick WHERE (x, y, z) = (?, ?, ?)", snapshot.unsaved
            )
            for row in self._packed(snapshot):
                self._connection.execute(PUT, (*row.key, row.revision, row.size, row.crc, row.data))
                rows, sizes = rows + 1, sizes + len(row.data)
            self._connection.executemany(REBUILT, snapshot.rebuilt)
            if snapshot.damaged or snapshot.unsaved or snapshot.rebuilt:
                lost = lost_crc(self._connection)
            self._put_progress(snapshot.revision, made(snapshot.position), lost)
        self._lost_crc = lost
        self.bricks_written += rows
        self.bytes_written += sizes

    def sync(self) -> bool:
        """Move the write-ahead log into the file and sync it.

        Returns:
            False if a reader holds the log.

        Raises:
            sqlite3.Error: it fails.
        """
        busy, *_ = self._connection.execute("PRAGMA wal_checkpoint(FULL)").fetchone()
        return not busy

    def forget(self, revision: int, position: bytes, identity: MapIdentity) -> MapIdentity:
        """Empty the map and the list of lost bricks.

        Returns:
            the new identity of the map.

        Raises:
            sqlite3.Error: it fails; the file is unchanged.
        """
        with transaction(self._connection):
            self._connection.execute("DELETE FROM brick")
            self._connection.execute("UPDATE quarantine SET rebuilt = 1, data = NULL")
            lost = lost_crc(self._connection)
            self._put_progress(revision, position, lost)
            emptied = renewed(self._connection, identity)
        self._lost_crc = lost
        return emptied

    def _put_progress(self, revision: int, position: bytes, lost: int) -> None:
        checksum = checksum_of(self._settings_crc, lost, revision, position)
        self._connection.execute(PROGRESS, (revision, position, checksum))

    def _packed(self, snapshot: Snapshot) -> Iterator[BrickRow]:
        for key, revision, brick in snapshot.bricks:
            self.bricks_packed += 1
            yield pack(self._compressor, key, revision, brick)


class Loader:
    """Reads tiles for the mapping thread; another thread may write.

    Args:
        connection: connection for reading.
        path: the file.
        edge: edge of a tile, in bricks.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, edge: int) -> None:
        self._connection = connection
        self._path = path
        self._edge = edge
        self._unpacker = zstandard.ZstdDecompressor()

    def load(self, core: _core.VoxelMap, tiles: list[Key]) -> dict[Key, str]:
        """Load tiles from the file.

        Returns:
            damaged bricks, with the reason; they are empty now.

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
        except ValueError:  # with a valid checksum: not written by this program
            core.put_bricks([], tiles)
            damaged |= _put_one_by_one(core, bricks)
        return damaged

    def damage(self, keys: Iterable[Key] | None = None) -> dict[Key, str]:
        """Return the damaged bricks of the file, with the reason.

        Args:
            keys: keys of the bricks to read; None reads the whole file and checks its structure.

        Raises:
            StoreError: it cannot be read, or its structure is damaged.
        """
        damaged: dict[Key, str] = {}
        if keys is None:
            check_structure(self._connection, self._path)
            for some in damaged_rows(self._connection, self._path):
                damaged |= some
            return damaged
        with translated(self._path), reading(self._connection):
            for key in keys:
                found = self._connection.execute(
                    f"SELECT {COLUMNS} FROM brick WHERE (x, y, z) = (?, ?, ?)",  # noqa: S608
                    key,
                )
                damaged |= _damage_of(rows_of(found))
        return damaged

    def _sound(self, rows: Iterable[BrickRow]) -> tuple[list[tuple[Key, bytes]], dict[Key, str]]:
        """Return the intact bricks of rows, and the damage of the others."""
        bricks = []
        damaged = {}
        for row in rows:
            _core.finish_part()
            try:
                bricks.append((row.key, unpack(self._unpacker, row)))
            except DamagedBrickError as error:
                damaged[row.key] = str(error)
        return bricks, damaged


def check_structure(connection: sqlite3.Connection, path: Path) -> None:
    """Check the structure of the file, its indexes, and its revisions.

    Raises:
        StoreError: they are damaged (`damaged`), or the file cannot be read.
    """
    with translated(path):
        for (verdict,) in connection.execute("PRAGMA integrity_check(1)"):
            if verdict != "ok":
                text = " ".join(verdict.replace("*** in database main ***", "").split())
                raise StoreError(f"{path}: {ADVICE['damaged']} ({text})", "damaged")


def damaged_rows(connection: sqlite3.Connection, path: Path) -> Iterator[dict[Key, str]]:
    """Read all bricks of the file in batches; yield the damaged ones, with the reason.

    Raises:
        StoreError: the file cannot be read.
    """
    last = -1 << 63
    while True:
        with translated(path):
            found = connection.execute(
                f"SELECT rowid, {COLUMNS} FROM brick WHERE rowid > ? ORDER BY rowid LIMIT ?",  # noqa: S608 our own text
                (last, ROWS_AT_ONCE),
            ).fetchall()
        if not found:
            return
        last = found[-1][0]
        yield _damage_of(rows_of(columns for _, *columns in found))


def _damage_of(rows: Iterable[BrickRow]) -> dict[Key, str]:
    damaged = {}
    for row in rows:
        try:
            check_row(row)
        except DamagedBrickError as error:
            damaged[row.key] = str(error)
    return damaged


def _put_one_by_one(core: _core.VoxelMap, bricks: list[tuple[Key, bytes]]) -> dict[Key, str]:
    damaged = {}
    for brick in bricks:
        try:
            core.put_bricks([brick])
        except ValueError as error:
            damaged[brick[0]] = str(error)
    return damaged
