"""The tables of the map's file, and how an older file becomes one of today."""

import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path

from mapperd.errors import StoreError
from mapperd.store.database import transaction

__all__ = ["APPLICATION_ID", "STEPS", "VERSION", "check_version", "migrate"]

APPLICATION_ID = int.from_bytes(b"mprd", "big")
"""In the file's header: what made it."""

Step = Callable[[sqlite3.Connection], None]

FIRST = (
    # What the map is; see mapperd.store.kind.
    "CREATE TABLE fact (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID",
    # One row: the map's revision, and the place in the input up to which it is complete.
    """CREATE TABLE progress (
        id INTEGER PRIMARY KEY CHECK (id = 1),
        revision INTEGER NOT NULL,
        position BLOB NOT NULL
    ) STRICT""",
    # The voxels; see mapperd.store.bricks. What a reader looks for stands before the data, so
    # that it is found without reading them.
    """CREATE TABLE brick (
        x INTEGER NOT NULL, y INTEGER NOT NULL, z INTEGER NOT NULL,
        revision INTEGER NOT NULL,
        size INTEGER NOT NULL,
        crc INTEGER NOT NULL,
        data BLOB NOT NULL,
        PRIMARY KEY (x, y, z)
    ) STRICT""",
    "CREATE INDEX brick_by_revision ON brick (revision)",
    # Rows of `brick` that were found damaged, as they were. The brick is lost until `rebuilt`.
    """CREATE TABLE quarantine (
        id INTEGER PRIMARY KEY,
        x INTEGER NOT NULL, y INTEGER NOT NULL, z INTEGER NOT NULL,
        revision, size, crc, data,
        reason TEXT NOT NULL,
        rebuilt INTEGER NOT NULL DEFAULT 0
    )""",
)


def _first(connection: sqlite3.Connection) -> None:
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    for statement in FIRST:
        connection.execute(statement)


STEPS: tuple[Step, ...] = (_first,)
"""Step n makes version n + 1 of version n; version 0 is an empty file."""

VERSION = len(STEPS)


def migrate(connection: sqlite3.Connection, path: Path, steps: Sequence[Step] = STEPS) -> None:
    """Bring a file to today's version, in one transaction; a new one comes the same way.

    Raises:
        StoreError: it is of another program, or of a newer version.
        sqlite3.Error: SQLite refuses; the file is as before.
    """
    if _version(connection, path, len(steps)) == len(steps):
        return
    with transaction(connection):
        for step in steps[_version(connection, path, len(steps)) :]:
            step(connection)
        connection.execute(f"PRAGMA user_version = {len(steps)}")


def check_version(connection: sqlite3.Connection, path: Path) -> None:
    """For who only reads, and migrates nothing.

    Raises:
        StoreError: it is of another program or another version.
    """
    version = _version(connection, path, VERSION)
    if version != VERSION:
        raise StoreError(
            f"{path}: is of version {version}, and becomes {VERSION} when mapperd opens it",
            "not_a_store",
        )


def _version(connection: sqlite3.Connection, path: Path, newest: int) -> int:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    empty = application == 0 and version == 0 and tables == 0
    if application != APPLICATION_ID and not empty:
        raise StoreError(f"{path}: is an SQLite file of another program", "not_a_store")
    if version > newest:
        raise StoreError(
            f"{path}: is of version {version}; this program knows up to {newest}", "newer_version"
        )
    return int(version)
