"""A state of the map, and how it gets into the file: whole, with its place in the input."""

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import zstandard

from mapperd.store.bricks import COLUMNS, LEVEL, BrickRow, Key, pack
from mapperd.store.database import transaction
from mapperd.store.metadata import Identity, renewed

__all__ = ["Position", "Saver", "Snapshot"]

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
