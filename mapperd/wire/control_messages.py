"""What clients and the daemon say to each other: one JSON object a line, version 1."""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct, field

from mapperd.api import PoseRequest

__all__ = [
    "VERSION",
    "Answer",
    "Ask",
    "Events",
    "Fault",
    "Get",
    "GlobalLocalization",
    "Greeting",
    "Hello",
    "InitialPose",
    "Localization",
    "NoMotionUpdate",
    "Params",
    "Reload",
    "Reset",
    "Save",
    "Set",
    "SetMap",
    "Snapshot",
    "Status",
    "answer_line",
    "decode_ask",
    "fault_line",
    "line_of",
    "plain",
]

VERSION = 1

Id = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Names = Annotated[list[str], Meta(max_length=1000)]


class _Ask(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do", tag=str.lower
):
    id: Id


class Hello(_Ask, frozen=True, kw_only=True):
    """The first request: which version is spoken, and where it is asked for the token's proof."""

    version: int
    proof: Annotated[str, Meta(max_length=64)] = ""


class Status(_Ask, frozen=True, kw_only=True):
    """How it goes."""


class Params(_Ask, frozen=True, kw_only=True):
    """All about settings or sections; none is all."""

    names: Names = field(default_factory=list)


class Get(_Ask, frozen=True, kw_only=True):
    """Values of settings or sections."""

    names: Annotated[list[str], Meta(min_length=1, max_length=1000)]


class Set(_Ask, frozen=True, kw_only=True):
    """Change settings, all or none."""

    changes: Annotated[dict[str, Any], Meta(min_length=1, max_length=1000)]


class Save(_Ask, frozen=True, kw_only=True):
    """Write the map into a file of the folder for maps."""

    name: Annotated[str, Meta(max_length=1000)]


class Reset(_Ask, frozen=True, kw_only=True):
    """Empty the map."""


class Reload(_Ask, frozen=True, kw_only=True):
    """Read the settings' files again."""


class Snapshot(_Ask, frozen=True, kw_only=True):
    """Bring the map and the recording to the disk."""


class Events(_Ask, frozen=True, kw_only=True):
    """What happened after an event's number; and from then on, as it happens."""

    since: Id = 0
    follow: bool = False


class Localization(_Ask, frozen=True, kw_only=True):
    """Where the vehicle is on the known map, and some of the particles."""

    particles: Annotated[int, Meta(ge=0, le=500)] = 0


class InitialPose(_Ask, frozen=True, kw_only=True, tag="initial_pose"):
    """Begin localization at a pose."""

    pose: PoseRequest


class GlobalLocalization(_Ask, frozen=True, kw_only=True, tag="global_localization"):
    """Begin localization anywhere on the map."""


class NoMotionUpdate(_Ask, frozen=True, kw_only=True, tag="request_nomotion_update"):
    """Have the next scan be an update."""


class SetMap(_Ask, frozen=True, kw_only=True, tag="set_map"):
    """Localize on another map; with a pose from there on."""

    name: Annotated[str, Meta(max_length=1000)]
    pose: PoseRequest | None = None


Ask = (
    Hello
    | Status
    | Params
    | Get
    | Set
    | Save
    | Reset
    | Reload
    | Snapshot
    | Events
    | Localization
    | InitialPose
    | GlobalLocalization
    | NoMotionUpdate
    | SetMap
)


class Greeting(Struct, frozen=True):
    """The daemon's first line.

    Attributes:
        mapperd: what this is.
        versions: that it speaks.
        challenge: to be answered by the proof of the token; without one none is needed.
    """

    mapperd: str = "control"
    versions: tuple[int, ...] = (VERSION,)
    challenge: str = ""


class Fault(Struct, frozen=True):
    """Why something was not done.

    Attributes:
        reason: short and stable.
        message: one line for a person.
        details: plain values.
    """

    reason: str
    message: str
    details: dict[str, Any] = field(default_factory=dict)


class Answer(Struct, frozen=True, omit_defaults=True):
    """What became of a request; the daemon's other lines are events.

    Attributes:
        id: of the request; None where it had none that could be read.
        result: of what was done.
        error: why nothing was.
    """

    id: int | None
    result: dict[str, Any] | None = None
    error: Fault | None = None


class _AnyId(Struct, frozen=True):
    id: Id | None = None


_ASKS = msgspec.json.Decoder(Ask)
_IDS = msgspec.json.Decoder(_AnyId)


def decode_ask(line: bytes) -> tuple[Ask | Fault, int | None]:
    """A request, or what is wrong with it; and its id, if it has one."""
    try:
        ask = _ASKS.decode(line)
    except (msgspec.DecodeError, RecursionError) as error:
        return Fault("bad_request", f"no request: {error}"), _id_of(line)
    return ask, ask.id


def answer_line(number: int | None, result: dict[str, Any]) -> bytes:
    """What is said when something was done."""
    return line_of(Answer(number, result=result))


def fault_line(number: int | None, fault: Fault) -> bytes:
    """What is said when it was not."""
    return line_of(Answer(number, error=fault))


def line_of(value: object) -> bytes:
    """One JSON value and the end of its line; what is not plain is said as text."""
    return msgspec.json.encode(value, enc_hook=plain) + b"\n"


def plain(value: object) -> object:
    """Numbers of numpy are numbers; anything else that JSON does not know is its text."""
    return value.item() if isinstance(value, np.generic) else str(value)


def _id_of(line: bytes) -> int | None:
    try:
        return _IDS.decode(line).id
    except (msgspec.DecodeError, RecursionError):
        return None
