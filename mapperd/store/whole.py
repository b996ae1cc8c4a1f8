"""The file of a whole map, written at once: for maps that were made elsewhere, or in parts."""

import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

import zstandard

from mapperd.config.tree import Config
from mapperd.store.bricks import COLUMNS, LEVEL, BrickRow, Key, pack
from mapperd.store.database import transaction, translated
from mapperd.store.kind import write_kind
from mapperd.store.metadata import begun
from mapperd.store.schema import migrate

__all__ = ["packed", "write_whole"]


def packed(bricks: Iterable[tuple[Key, int, bytes]]) -> Iterator[BrickRow]:
    """Rows of bricks: (key, revision, bytes) each."""
    compressor = zstandard.ZstdCompressor(level=LEVEL)
    for key, revision, brick in bricks:
        yield pack(compressor, key, revision, brick)


def write_whole(path: Path, config: Config, revision: int, rows: Iterable[BrickRow]) -> int:
    """Make a map's file that `TileStore` and `StoreReader` open like any other.

    Whoever calls it gives the file its name when it is whole: a stop half way leaves it damaged.

    Args:
        path: of the file; nothing is there yet.
        config: the settings that the map came about by.
        revision: of the map.
        rows: its bricks, each once.

    Returns:
        how many there are.

    Raises:
        StoreError: it cannot be written, or a brick comes twice.
    """
    count = 0
    with translated(path):
        connection = sqlite3.connect(path, isolation_level=None)
        try:
            connection.execute("PRAGMA journal_mode = OFF")
            connection.execute("PRAGMA synchronous = OFF")
            migrate(connection, path)
            with transaction(connection):
                write_kind(connection, config)
                connection.execute("INSERT INTO progress VALUES (1, ?, x'')", (revision,))
                begun(connection, revision)
                for row in rows:
                    connection.execute(
                        f"INSERT INTO brick ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)",  # noqa: S608 our own text
                        (*row.key, row.revision, row.size, row.crc, row.data),
                    )
                    count += 1
        finally:
            connection.close()
    return count
