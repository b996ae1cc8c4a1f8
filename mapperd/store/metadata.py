"""Which map a file holds, and up to where it holds what sessions before told of it.

Revisions of a map go on from session to session, but what a session mapped after its last save is
gone with it, and its revisions are used again. A session's revisions therefore mean something up
to what the file held when the next one began, and no further.
"""

import secrets
import sqlite3
from dataclasses import dataclass

import msgspec

__all__ = ["NAME", "Identity", "begun", "fresh", "renewed"]

NAME = "map.identity"
"""Of the row in the table `fact`."""

MOST_SESSIONS = 16


@dataclass(frozen=True, slots=True)
class Identity:
    """Of a map.

    Attributes:
        map: id of it; another one after a reset.
        session: of the program that has the map now.
        earlier: sessions before it, and the revision up to which each is as the file has it;
            oldest first.
    """

    map: str
    session: str
    earlier: tuple[tuple[str, int], ...] = ()

    def valid_up_to(self, session: str) -> int | None:
        """The revision up to which an earlier session's are good; None for one nobody knows."""
        return dict(self.earlier).get(session)


def fresh() -> Identity:
    """Of an empty map."""
    return Identity(_random(), _random())


def begun(connection: sqlite3.Connection, revision: int) -> Identity:
    """A session begins with what the file holds; in a transaction of the caller.

    Args:
        connection: to the file.
        revision: of the map in it.
    """
    found = connection.execute("SELECT value FROM fact WHERE name = ?", (NAME,)).fetchone()
    before = _decoded(found[0]) if found is not None else None
    if before is None:
        identity = fresh()
    else:
        earlier = (*before.earlier, (before.session, revision))
        identity = Identity(before.map, _random(), earlier[-MOST_SESSIONS:])
    _put(connection, identity)
    return identity


def renewed(connection: sqlite3.Connection, identity: Identity) -> Identity:
    """The map was emptied; in a transaction of the caller."""
    emptied = Identity(_random(), identity.session)
    _put(connection, emptied)
    return emptied


def _put(connection: sqlite3.Connection, identity: Identity) -> None:
    text = msgspec.json.encode(identity).decode()
    connection.execute("INSERT OR REPLACE INTO fact VALUES (?, ?)", (NAME, text))


def _decoded(text: str) -> Identity | None:
    """None for what is damaged: then it is another map, and everybody is told all of it."""
    try:
        return msgspec.json.decode(text, type=Identity)
    except msgspec.DecodeError:
        return None


def _random() -> str:
    return secrets.token_hex(8)
