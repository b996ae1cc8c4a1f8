"""Connections to the map's file, and what SQLite's errors mean for it."""

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from mapperd.errors import StoreError

__all__ = ["open_reader", "open_writer", "reading", "transaction", "translated"]

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
