"""Reads ViewPoint logs (`.oculus`, version 2): SQLite files with one message per row of `data`.

The file is not trusted: only a plain table is read, sizes are queried before content, and SQLite
runs no code from the file.
"""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from oculus_driver.recording.chunk import OCULUS, Chunk, Progress
from oculus_driver.recording.oculus_log import message_bytes, stamp_ns
from oculus_driver.wire import MAX_MESSAGE_SIZE

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Iterator

LINK: Final = "sonar"
_MS_PER_S: Final = 1000
_OCULUS_SOURCE: Final = 0
_MAX_SOURCES: Final = 64
_MAX_TEXTS: Final = 256
_MAX_TEXT: Final = 4096
_LIMIT: Final = MAX_MESSAGE_SIZE + (1 << 16)
"""Maximum bytes of one row or value in SQLite."""

_PRIMARY: Final = 0xFF
"""Mask of the primary part of SQLite's result codes."""

_PLAIN_TABLE: Final = """
    SELECT count(*) FROM sqlite_master
    WHERE type = 'table' AND name = ? AND rootpage > 0
"""
_ROWS: Final = """
    SELECT rowid, timestamp, dataSourceId, length(payload),
           CASE WHEN length(payload) <= ? THEN CAST(payload AS BLOB) END
    FROM data ORDER BY rowid
"""


def read_viewpoint_log(file: BinaryIO, size: int, progress: Progress) -> Iterator[Chunk]:
    """Yield the messages of a ViewPoint log of `size` bytes by entry; update `progress`.

    Raises:
        OSError: the file cannot be read; its content is not the reason.
    """
    import sqlite3  # noqa: PLC0415 - only these files need it

    try:
        connection = _open(Path(file.name))
        try:
            for chunk in _chunks(connection, progress):
                progress.bytes_read = min(progress.bytes_read + len(chunk.data), size)
                yield chunk
        finally:
            connection.close()
    except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
        # UnicodeDecodeError: SQLite's message quotes invalid text of the file.
        if _is_refused(error):
            raise OSError(errno.EIO, str(error), file.name) from error
        progress.report_truncation(f"read error: {error}")
    progress.bytes_read = size


def is_ros_bag(path: Path) -> bool:
    """Return whether an SQLite file is a ROS 2 bag; false if it cannot be read."""
    import sqlite3  # noqa: PLC0415 - only these files need it

    try:
        connection = _open(path)
        try:
            return all(_has(connection, table) for table in ("topics", "messages"))
        finally:
            connection.close()
    except (sqlite3.Error, UnicodeDecodeError):
        return False


def _is_refused(error: Exception) -> bool:
    """Return whether a disk, a lock or permissions kept SQLite from reading: not a damaged file."""
    import sqlite3  # noqa: PLC0415 - only these files need it

    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_OK)
    if code == sqlite3.SQLITE_IOERR_SHORT_READ:  # the file is truncated
        return False
    return code & _PRIMARY in {
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_PERM,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_FULL,
    }


def _open(path: Path) -> sqlite3.Connection:
    """Open for reading only; a write-ahead log beside the file is read, too."""
    import sqlite3  # noqa: PLC0415 - only these files need it

    alone = not path.with_name(path.name + "-wal").exists()
    uri = path.absolute().as_uri() + "?mode=ro" + ("&immutable=1" if alone else "")
    connection = sqlite3.connect(uri, uri=True, check_same_thread=False)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LIMIT)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.text_factory = bytes
    return connection


def _chunks(connection: sqlite3.Connection, progress: Progress) -> Iterator[Chunk]:
    if not _has(connection, "data"):
        progress.report("not a ViewPoint log: it has no table named data")
        return
    progress.metadata = _metadata(connection)
    sources = _sources(connection)
    links: dict[Any, str] = {}
    gap = False
    for number, time_ms, source, length, payload in connection.execute(_ROWS, (MAX_MESSAGE_SIZE,)):
        if sources.get(source, _OCULUS_SOURCE) != _OCULUS_SOURCE:
            continue
        data = None if payload is None else message_bytes(payload)
        link = _link(links, source)
        if data is None or link is None:
            gap = True
            progress.report(f"entry {number}: no Oculus message in {length} bytes")
            continue
        arrival_ns = stamp_ns(time_ms, _MS_PER_S) if isinstance(time_ms, int | float) else None
        progress.note_stamp(arrival_ns)
        yield Chunk(link, OCULUS, arrival_ns, data, gap)
        gap = False


def _has(connection: sqlite3.Connection, table: str) -> bool:
    return bool(connection.execute(_PLAIN_TABLE, (table,)).fetchone()[0])


def _metadata(connection: sqlite3.Connection) -> dict[str, str]:
    if not _has(connection, "metadata"):
        return {}
    query = "SELECT key, value FROM metadata WHERE length(value) <= ? LIMIT ?"
    rows = connection.execute(query, (_MAX_TEXT, _MAX_TEXTS))
    return {_text(key): _text(value) for key, value in rows}


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _sources(connection: sqlite3.Connection) -> dict[Any, Any]:
    """Return the type of each data source by id."""
    if not _has(connection, "dataSources"):
        return {}
    query = "SELECT dataSourceId, dataSourceType FROM dataSources LIMIT ?"
    return dict(connection.execute(query, (_MAX_SOURCES,)).fetchall())


def _link(links: dict[Any, str], source: object) -> str | None:
    """Return the link of a source, numbered by appearance; None beyond the limit."""
    if source not in links:
        if len(links) == _MAX_SOURCES:
            return None
        links[source] = f"{LINK}-{len(links) + 1}" if links else LINK
    return links[source]
