"""Metadata of a map's file: identity, settings and progress.

Revisions continue from session to session. A crash loses what a session mapped after its last
save, and the next session uses those revisions again. A session's revisions are therefore valid
only up to the revision that the file had when the next session started.

The stored settings are those that the voxels depend on. They cannot change while the program runs,
so that all voxels of a file follow one rule. A file without `mapping.rule` is of IWLO.

The row of the table `progress` holds a CRC-32 of the settings, the revision, the position and the
keys of the lost bricks. Files of version 1 have none.
"""

import json
import secrets
import sqlite3
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from mapperd.config.catalog import parameters
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.mapping.core_args import fixed_settings

__all__ = [
    "NAME",
    "MapIdentity",
    "begun",
    "check_checksum",
    "check_kind",
    "checksum_of",
    "differences",
    "fresh",
    "kind_in",
    "kind_of",
    "lost_crc",
    "lost_in",
    "progress_in",
    "renewed",
    "restore_settings",
    "settings_crc",
    "write_checksum",
    "write_kind",
]

NAME = "map.identity"
"""Name of the row in the table `fact`."""

MAX_SESSIONS = 16


@dataclass(frozen=True, slots=True)
class MapIdentity:
    """Identity of a map.

    Attributes:
        map: id of the map; a reset changes it.
        session: id of the current session.
        earlier: earlier sessions, oldest first, each with the last revision that is valid.
    """

    map: str
    session: str
    earlier: tuple[tuple[str, int], ...] = ()

    def valid_up_to(self, session: str) -> int | None:
        """Return the last valid revision of an earlier session; None if unknown."""
        return dict(self.earlier).get(session)


def fresh() -> MapIdentity:
    """Return the identity of an empty map."""
    return MapIdentity(_random(), _random())


def begun(connection: sqlite3.Connection, revision: int) -> MapIdentity:
    """Start a session with the file's content, in a transaction of the caller.

    Args:
        connection: connection to the file.
        revision: revision of its map.
    """
    found = connection.execute("SELECT value FROM fact WHERE name = ?", (NAME,)).fetchone()
    before = _decoded(found[0]) if found is not None else None
    if before is None:
        identity = fresh()
    else:
        earlier = (*before.earlier, (before.session, revision))
        identity = MapIdentity(before.map, _random(), earlier[-MAX_SESSIONS:])
    _put(connection, identity)
    return identity


def renewed(connection: sqlite3.Connection, identity: MapIdentity) -> MapIdentity:
    """Note that the map was emptied, in a transaction of the caller."""
    emptied = MapIdentity(_random(), identity.session)
    _put(connection, emptied)
    return emptied


def _put(connection: sqlite3.Connection, identity: MapIdentity) -> None:
    text = msgspec.json.encode(identity).decode()
    connection.execute("INSERT OR REPLACE INTO fact VALUES (?, ?)", (NAME, text))


def _decoded(text: str) -> MapIdentity | None:
    """Return the identity; None if damaged: clients then receive the whole map again."""
    try:
        return msgspec.json.decode(text, type=MapIdentity)
    except ValueError:  # malformed, or not UTF-8
        return None


def _random() -> str:
    return secrets.token_hex(8)


RULE, IWLO = "mapping.rule", json.dumps("iwlo")


def kind_of(config: Config) -> dict[str, str]:
    """Return the settings by full name, as JSON."""
    return {name: json.dumps(value) for name, value in fixed_settings(config).items()}


def differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return name and both values of settings that differ, of those that `theirs` has.

    Of maps of different rules the rule alone differs.
    """
    rules = theirs.get(RULE, IWLO), ours.get(RULE, IWLO)
    if rules[0] != rules[1]:
        return [(RULE, *rules)]
    return [
        (name, value, ours.get(name, "unknown"))
        for name, value in sorted(theirs.items())
        if ours.get(name) != value
    ]


def write_kind(connection: sqlite3.Connection, config: Config) -> None:
    """Write the metadata of a new file."""
    connection.executemany("INSERT INTO fact VALUES (?, ?)", kind_of(config).items())


def kind_in(connection: sqlite3.Connection, path: Path) -> dict[str, Any]:
    """Return the stored settings by full name, those that this program knows.

    Raises:
        StoreError: one of them is damaged.
    """
    rows = connection.execute("SELECT name, value FROM fact")
    known = parameters()
    try:
        found = {name: json.loads(value) for name, value in rows if name in known}
        return {RULE: "iwlo"} | found
    except (TypeError, ValueError) as error:
        raise StoreError(f"{path}: is damaged: a setting in it: {error}", "damaged") from error


def check_kind(connection: sqlite3.Connection, path: Path, config: Config) -> None:
    """Check that settings are those of the file; settings that the file lacks are new.

    Raises:
        StoreError: some differ; the text names all of them.
    """
    stored = dict(connection.execute("SELECT name, value FROM fact WHERE name != ?", (NAME,)))
    differ = [
        f"{name} is {value} in it, {ours} in the settings"
        for name, value, ours in differences(stored, kind_of(config))
    ]
    if differ:
        raise StoreError(
            f"{path}: holds a map of other settings: {'; '.join(differ)}. Set them back, or give "
            "another outofcore.map_path",
            "other_parameters",
        )


MAX_REVISION = 1 << 62
"""Maximum revision; no map changes that often, and SQLite's integers end at twice that."""


def progress_in(connection: sqlite3.Connection, path: Path) -> tuple[int, bytes] | None:
    """Return revision and position of the last save; None in a new file.

    Raises:
        StoreError: they are invalid, as after a flipped bit.
    """
    found = connection.execute("SELECT revision, position FROM progress").fetchone()
    if found is None:
        return None
    revision, position = found
    if not (isinstance(revision, int) and 0 <= revision < MAX_REVISION):
        raise StoreError(f"{path}: is damaged: {revision!r} is no revision of a map", "damaged")
    if not isinstance(position, bytes):
        raise StoreError(f"{path}: is damaged: its position is not a blob", "damaged")
    return revision, position


Key = tuple[int, int, int]


def lost_in(connection: sqlite3.Connection, path: Path) -> set[Key]:
    """Return the keys of damaged bricks that are not rebuilt.

    Raises:
        StoreError: one of them is not a key.
    """
    keys = set(connection.execute(LOST))
    if not all(isinstance(value, int) for key in keys for value in key):
        raise StoreError(f"{path}: is damaged: a lost brick has no key", "damaged")
    return keys


LOST = "SELECT x, y, z FROM quarantine WHERE NOT rebuilt"


def checksum_of(settings: int, lost: int, revision: int, position: bytes) -> int:
    """Compute the checksum of a file.

    Args:
        settings: result of `settings_crc`.
        lost: result of `lost_crc`.
        revision: revision of the map.
        position: position in the input.
    """
    return zlib.crc32(msgspec.msgpack.encode((settings, lost, revision, position)))


def settings_crc(connection: sqlite3.Connection) -> int:
    """Compute the CRC-32 of the settings in a file."""
    return _crc_of(connection.execute("SELECT name, value FROM fact WHERE name != ?", (NAME,)))


def lost_crc(connection: sqlite3.Connection) -> int:
    """Compute the CRC-32 of the keys of a file's lost bricks."""
    return _crc_of(connection.execute(LOST))


def _crc_of(rows: Iterable[tuple[Any, ...]]) -> int:
    """Return the CRC-32 of rows in any order; damaged rows may hold values of any type."""
    return zlib.crc32(msgspec.msgpack.encode(sorted(rows, key=repr)))


def write_checksum(connection: sqlite3.Connection) -> None:
    """Write the checksum of the file's metadata, in a transaction of the caller."""
    found = connection.execute("SELECT revision, position FROM progress").fetchone()
    checksum = checksum_of(settings_crc(connection), lost_crc(connection), *found)
    connection.execute("UPDATE progress SET checksum = ?", (checksum,))


def check_checksum(connection: sqlite3.Connection, path: Path) -> bool:
    """Verify settings, revision, position and lost bricks by their checksum.

    Returns:
        False if the file has no checksum (version 1).

    Raises:
        StoreError: one of them is damaged.
    """
    found = connection.execute("SELECT * FROM progress").fetchone()
    if found is None:
        if connection.execute("SELECT count(*) FROM fact").fetchone()[0]:
            raise StoreError(f"{path}: is damaged: its progress is missing", "damaged")
        return True
    _, revision, position, *checksum = found
    if not checksum or checksum[0] is None:
        return False
    facts = settings_crc(connection), lost_crc(connection), revision, position
    if checksum[0] != checksum_of(*facts):
        text = (
            "its settings, its position or its list of lost bricks are damaged: put it aside, and "
            "map its recordings again"
        )
        raise StoreError(f"{path}: {text}", "damaged")
    return True


def restore_settings(connection: sqlite3.Connection, config: Config) -> bool:
    """Replace damaged settings of a file by others if these match its checksum.

    Returns:
        whether they match.
    """
    revision, position, checksum = connection.execute(
        "SELECT revision, position, checksum FROM progress"
    ).fetchone()
    settings = _crc_of(kind_of(config).items())
    if checksum != checksum_of(settings, lost_crc(connection), revision, position):
        return False
    connection.execute("DELETE FROM fact WHERE name != ?", (NAME,))
    write_kind(connection, config)
    return True
