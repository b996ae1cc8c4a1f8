"""How far a stored map is: its revision, and its place in the input."""

import sqlite3
from pathlib import Path

from mapperd.errors import StoreError

__all__ = ["progress_in"]

MOST_REVISION = 1 << 62
"""No map changes that often; SQLite's numbers end at twice that."""


def progress_in(connection: sqlite3.Connection, path: Path) -> tuple[int, bytes] | None:
    """Revision and position of the last save; None in a new file.

    Raises:
        StoreError: they are none, as after a bit of the file has turned.
    """
    found = connection.execute("SELECT revision, position FROM progress").fetchone()
    if found is None:
        return None
    revision, position = found
    if not (isinstance(revision, int) and 0 <= revision < MOST_REVISION):
        raise StoreError(f"{path}: is damaged: {revision!r} is no revision of a map", "damaged")
    if not isinstance(position, bytes):
        raise StoreError(f"{path}: is damaged: its position is no bytes", "damaged")
    return revision, position
