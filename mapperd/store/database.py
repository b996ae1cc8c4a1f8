"""The map's file: its connections, its tables, and the lock of its one writer."""

import contextlib
import errno
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from mapperd.errors import StoreError, os_reason
from mapperd.io import lock_file

__all__ = [
    "APPLICATION_ID",
    "STEPS",
    "VERSION",
    "check_version",
    "migrate",
    "only_writer",
    "open_reader",
    "open_writer",
    "reading",
    "transaction",
    "translated",
]

BUSY_S = 10.0
"""Only a checkpoint or a migration holds others up, and none for that long."""

CACHE_KIB = 8192
"""Of pages, a connection."""

REASONS = {
    sqlite3.SQLITE_BUSY: "busy",
    sqlite3.SQLITE_LOCKED: "busy",
    sqlite3.SQLITE_READONLY: "read_only",
    sqlite3.SQLITE_PERM: "read_only",
    sqlite3.SQLITE_CORRUPT: "damaged",
    sqlite3.SQLITE_NOTADB: "not_a_store",
    sqlite3.SQLITE_FULL: "disk_full",
    sqlite3.SQLITE_CANTOPEN: "cannot_open",
}
"""Primary result codes (sqlite.org/rescode.html); whatever else fails is the disk's."""

ADVICE = {
    "busy": "another program holds it",
    "read_only": "it cannot be written to",
    "damaged": "its structure is damaged: put it aside, and map its recordings again",
    "not_a_store": "it is no SQLite file",
    "disk_full": "the disk is full",
    "cannot_open": "it cannot be opened",
    "io_error": "the disk does not do what it is asked",
}


@contextlib.contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn SQLite's errors into ours."""
    try:
        yield
    except UnicodeDecodeError as error:  # names of the schema, in SQLite's own message
        raise StoreError(f"{path}: {ADVICE['damaged']} ({error})", "damaged") from error
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_IOERR)
        reason = REASONS.get(code & 0xFF, "io_error")
        raise StoreError(f"{path}: {ADVICE[reason]} ({error})", reason) from error


def open_writer(path: Path) -> sqlite3.Connection:
    """Open the file to read and to write, and make it if it is not there.

    A commit survives the death of the process at once, and the loss of power from the next
    checkpoint on: until then the file goes back to an older commit, whole, position and all.

    Raises:
        StoreError: it cannot be.
    """
    with translated(path):
        connection = sqlite3.connect(
            path, timeout=BUSY_S, isolation_level=None, check_same_thread=False
        )
        try:
            (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.execute(f"PRAGMA cache_size = -{CACHE_KIB}")
            connection.execute(f"PRAGMA journal_size_limit = {64 << 20}")
        except sqlite3.Error:
            connection.close()
            raise
        if mode != "wal":
            connection.close()
            raise StoreError(f"{path}: its file system has no shared memory", "cannot_open")
        return connection


def open_reader(path: Path, *, finished: bool = False) -> sqlite3.Connection:
    """Open the file to read only, beside a writer in this or another process.

    Args:
        path: of the file.
        finished: there is no writer, and none will be: take no locks.

    Raises:
        StoreError: it cannot be.
    """
    name = f"file:{quote(str(path.resolve()))}?mode=ro"
    with translated(path):
        if finished:
            return _checked(f"{name}&immutable=1")
        try:
            return _checked(name)
        except sqlite3.OperationalError:
            # On a read-only medium there is no place for the index of a journal, nor, where
            # nothing is left to be taken over from one, a need of it.
            if not path.exists() or _has_journal(path):
                raise
            return _checked(f"{name}&immutable=1")


def _has_journal(path: Path) -> bool:
    journal = path.with_name(f"{path.name}-wal")
    return journal.exists() and journal.stat().st_size > 0


def _checked(name: str) -> sqlite3.Connection:
    connection = sqlite3.connect(
        name, uri=True, timeout=BUSY_S, isolation_level=None, check_same_thread=False
    )
    try:
        connection.execute(f"PRAGMA cache_size = -{CACHE_KIB}")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        connection.close()
        raise
    return connection


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """All or nothing, for one writer."""
    connection.execute("BEGIN IMMEDIATE")
    yield from _ended(connection)


@contextlib.contextmanager
def reading(connection: sqlite3.Connection) -> Iterator[None]:
    """One state of the file, whatever is written meanwhile."""
    connection.execute("BEGIN")
    yield from _ended(connection)


def _ended(connection: sqlite3.Connection) -> Iterator[None]:
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # some errors have rolled back already
            connection.execute("ROLLBACK")
        raise


APPLICATION_ID = int.from_bytes(b"mprd", "big")
"""In the file's header: what made it."""

Step = Callable[[sqlite3.Connection], None]

FIRST = (
    # What the map is; see mapperd.store.metadata.
    "CREATE TABLE fact (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID",
    # One row: the map's revision, and the place in the input up to which it is complete.
    """CREATE TABLE progress (
        id INTEGER PRIMARY KEY CHECK (id = 1),
        revision INTEGER NOT NULL,
        position BLOB NOT NULL
    ) STRICT""",
    # The voxels; see mapperd.store.tiles. What a reader looks for stands before the data, so
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


def _second(connection: sqlite3.Connection) -> None:
    """Add the checksum of the settings and the progress; see mapperd.store.metadata."""
    columns = {name for _, name, *_ in connection.execute("PRAGMA table_info(progress)")}
    if "checksum" not in columns:  # as after damage of the version
        connection.execute("ALTER TABLE progress ADD COLUMN checksum INTEGER")


STEPS: tuple[Step, ...] = (_first, _second)
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
    """Check that a reader, which migrates nothing, can read a file; earlier versions are readable.

    Raises:
        StoreError: it is empty, of another program or of a newer version.
    """
    version = _version(connection, path, VERSION)
    if version == 0:
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


@contextlib.contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold a lock beside the file, which ends with the process however that ends.

    Raises:
        StoreError: another process has it, or the folder cannot be written into.
    """
    lock = path.with_name(f"{path.name}.lock")
    try:
        handle = lock_file(lock, mode=0o644)
    except BlockingIOError as error:
        raise StoreError(f"{path}: another mapperd maps into it", "in_use") from error
    except OSError as error:
        reason = "disk_full" if error.errno == errno.ENOSPC else "read_only"
        raise StoreError(f"{lock}: cannot be made: {os_reason(error)}", reason) from error
    try:
        yield
    finally:
        os.close(handle)
