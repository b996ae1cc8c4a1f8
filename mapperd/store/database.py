"""The map's file: connections, tables, and the lock of its single writer."""

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
"""Timeout for locks; only checkpoints and migrations hold them, for less than that."""

CACHE_KIB = 8192
"""Page cache of a connection."""

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
"""Reasons by primary result code (sqlite.org/rescode.html); others mean a disk error."""

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
    """Convert SQLite's errors to `StoreError`."""
    try:
        yield
    except UnicodeDecodeError as error:  # names in the schema, in SQLite's message
        raise StoreError(f"{path}: {ADVICE['damaged']} ({error})", "damaged") from error
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_IOERR)
        reason = REASONS.get(code & 0xFF, "io_error")
        raise StoreError(f"{path}: {ADVICE[reason]} ({error})", reason) from error


def open_writer(path: Path) -> sqlite3.Connection:
    """Open the file for reading and writing; create it if missing.

    A commit survives a crash of the process at once, and a power loss from the next checkpoint on.
    After an earlier power loss the file returns to an older commit, complete with its position.

    Raises:
        StoreError: it cannot be opened.
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
    """Open the file read-only; a writer in this or another process may be active.

    Args:
        path: the file.
        finished: there is no writer and will be none: use no locks.

    Raises:
        StoreError: it cannot be opened.
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
    """Run a transaction of the writer."""
    connection.execute("BEGIN IMMEDIATE")
    yield from _ended(connection)


@contextlib.contextmanager
def reading(connection: sqlite3.Connection) -> Iterator[None]:
    """Read one state of the file, regardless of writes meanwhile."""
    connection.execute("BEGIN")
    yield from _ended(connection)


def _ended(connection: sqlite3.Connection) -> Iterator[None]:
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # some errors roll back by themselves
            connection.execute("ROLLBACK")
        raise


APPLICATION_ID = int.from_bytes(b"mprd", "big")
"""Application id in the file's header."""

Step = Callable[[sqlite3.Connection], None]

FIRST = (
    # Identity and settings of the map; see mapperd.store.metadata.
    "CREATE TABLE fact (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID",
    # One row: the map's revision, and the position in the input up to which it is complete.
    """CREATE TABLE progress (
        id INTEGER PRIMARY KEY CHECK (id = 1),
        revision INTEGER NOT NULL,
        position BLOB NOT NULL
    ) STRICT""",
    # The voxels; see mapperd.store.tiles. Columns that readers search precede the data, so
    # that they are found without reading it.
    """CREATE TABLE brick (
        x INTEGER NOT NULL, y INTEGER NOT NULL, z INTEGER NOT NULL,
        revision INTEGER NOT NULL,
        size INTEGER NOT NULL,
        crc INTEGER NOT NULL,
        data BLOB NOT NULL,
        PRIMARY KEY (x, y, z)
    ) STRICT""",
    "CREATE INDEX brick_by_revision ON brick (revision)",
    # Damaged rows of `brick`, unchanged. The brick is lost until `rebuilt`.
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
    if "checksum" not in columns:  # as after damage of the version number
        connection.execute("ALTER TABLE progress ADD COLUMN checksum INTEGER")


STEPS: tuple[Step, ...] = (_first, _second)
"""Step n upgrades version n to n + 1; version 0 is an empty file."""

VERSION = len(STEPS)


def migrate(connection: sqlite3.Connection, path: Path, steps: Sequence[Step] = STEPS) -> None:
    """Upgrade a file to the current version in one transaction; new files start at version 0.

    Raises:
        StoreError: it is of another program, or of a newer version.
        sqlite3.Error: SQLite fails; the file is unchanged.
    """
    if _version(connection, path, len(steps)) == len(steps):
        return
    with transaction(connection):
        for step in steps[_version(connection, path, len(steps)) :]:
            step(connection)
        connection.execute(f"PRAGMA user_version = {len(steps)}")


def check_version(connection: sqlite3.Connection, path: Path) -> None:
    """Check that a reader can read a file without migration; earlier versions are readable.

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
    """Hold a lock file next to the file; the lock ends with the process.

    Raises:
        StoreError: another process holds it, or the folder is not writable.
    """
    lock = path.with_name(f"{path.name}.lock")
    try:
        handle = lock_file(lock, mode=0o644)
    except BlockingIOError as error:
        text = f"{path}: another mapperd maps into it: stop it, or set outofcore.map_path"
        raise StoreError(text, "in_use") from error
    except OSError as error:
        reason = "disk_full" if error.errno == errno.ENOSPC else "read_only"
        raise StoreError(f"{lock}: cannot be made: {os_reason(error)}", reason) from error
    try:
        yield
    finally:
        os.close(handle)
