"""What a client of the map stream says."""

from typing import Annotated

import msgspec
from msgspec import Meta, Struct, field

from mapperd.wire.protocol import Box, Count, Interest, Message, Name, Want

__all__ = ["Ack", "Ask", "Change", "Hello", "Resume"]


class Resume(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a client holds already.

    Attributes:
        map: id of the map that it holds.
        session: of the daemon that said `revision`.
        revision: all of its interest is as it was then, or newer; None before that was ever so.
        level, detail, radius_m, box: the interest in what it holds.
        newest: the highest revision of any message about the map that it used; None is unknown.
        path: points of the path that it holds.
        path_version: of them.
        ticket: of the welcome of the connection before this one; "" where it had none.
        bytes: of that connection that were read and used, as `Ack` counts them.
    """

    map: Name
    session: Name
    revision: Count | None = None
    level: int = 0
    detail: str = "log_odds"
    radius_m: float = 0.0
    box: Box | None = None
    newest: Count | None = None
    path: Count = 0
    path_version: Count = 0
    ticket: Annotated[str, Meta(max_length=64)] = ""
    bytes: Count = 0


class Hello(Message, frozen=True, kw_only=True):
    """The first message of a client.

    Attributes:
        version: that is to be spoken.
        proof: that the token is known; "" without one.
        name: of the program, for people.
        wants: kinds of messages.
        interest: in the map.
        bytes_per_s: at most; 0 leaves it to the link.
        resume: what the client holds.
        events_since: number of the last event that it has; None is told of new ones alone.
        beside: ticket of a living connection of the same client, whose second line this one is;
            then nothing else of these is heeded but `version`, `proof` and `name`.
    """

    version: int
    proof: Annotated[str, Meta(max_length=64)] = ""
    name: Name = ""
    wants: Annotated[list[Want], Meta(max_length=32)] = field(default_factory=list)
    interest: Interest = field(default_factory=Interest)
    bytes_per_s: Annotated[int, Meta(ge=0, le=1 << 40)] = 0
    resume: Resume | None = None
    events_since: Count | None = None
    beside: Annotated[str, Meta(max_length=64)] = ""


class Change(Message, frozen=True, kw_only=True):
    """Something else is wanted from now on; what is None stays."""

    wants: Annotated[list[Want], Meta(max_length=32)] | None = None
    interest: Interest | None = None
    bytes_per_s: Annotated[int, Meta(ge=0, le=1 << 40)] | None = None


class Ack(Message, frozen=True, kw_only=True):
    """So many bytes of this connection have been read and used, the lengths of messages too."""

    bytes: Count


class Ask(Message, frozen=True, kw_only=True):
    """A request of docs/control.md: `{"do": "set", "id": 7, "changes": {...}}`."""

    ask: msgspec.Raw
