"""What a daemon decided that the bytes do not determine, recorded beside them.

They are one more link of a recording, one msgpack map in each chunk. *Orders* stand in the stream
where they take effect: from the next bytes on. *Remarks* come later than the bytes that they are
about and name the ping: the first of a session is number 0, and every ping message counts.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec import Struct

from oculus_driver.recording import Chunk

__all__ = [
    "DECISIONS",
    "LINK",
    "SESSION",
    "Covariance9",
    "Decision",
    "Drop",
    "Gap",
    "GlobalLocalization",
    "InitialPose",
    "NewMap",
    "NoMotionUpdate",
    "Numbers12",
    "Remarks",
    "RemovedRemark",
    "Request",
    "Reset",
    "ResetFailed",
    "Session",
    "SetMap",
    "Settings",
    "Skip",
    "chunk_of",
    "decision_of",
    "is_remark",
    "remarks_in",
    "without_skipped",
]

LINK = "mapperd"
SESSION = "session"
"""Key of the session's id in the metadata of its recordings."""

DECISIONS = "mapperd-decisions"
"""Encoding of the link."""

Covariance9 = tuple[float, float, float, float, float, float, float, float, float]
"""Of x, y and yaw, row by row."""

Numbers12 = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float
]
"""x, y, yaw, and their covariance."""


class Session(Struct, frozen=True, tag_field="kind", tag="session"):
    """A run of the daemon begins here.

    Attributes:
        id: of the run.
        version: of the program.
        settings: all of them, as plain values.
        pose: x, y, z in metres and w, x, y, z of a vehicle that stands still; None is odometry.
        saved_pose: the estimate that localization began with; None where there was none.
        map_sha256: of the map that localization began with; empty where there was none.
    """

    id: str
    version: str
    settings: dict[str, Any]
    pose: tuple[float, float, float, float, float, float, float] | None = None
    saved_pose: Numbers12 | None = None
    map_sha256: str = ""


class Settings(Struct, frozen=True, tag_field="kind", tag="settings"):
    """Settings that hold from here on, by name, and who asked."""

    values: dict[str, Any]
    origin: str = ""


class Reset(Struct, frozen=True, tag_field="kind", tag="reset"):
    """The map was emptied: pings that are settled by bytes before this are not in it.

    Attributes:
        number: of this reset in its session.
        origin: who asked.
    """

    number: int
    origin: str = ""


class ResetFailed(Struct, frozen=True, tag_field="kind", tag="reset_failed"):
    """A reset could not be carried out: the map is as it was."""

    number: int


class InitialPose(Struct, frozen=True, tag_field="kind", tag="initial_pose"):
    """Localization begins anew around a pose.

    Attributes:
        number: of this request in its session.
        x_m, y_m, yaw_rad: mean.
        covariance: symmetric, positive semi-definite; m2, m rad, rad2.
        frame: that the pose is in.
        origin: who asked.
    """

    number: int
    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Covariance9
    frame: str
    origin: str = ""


class GlobalLocalization(Struct, frozen=True, tag_field="kind", tag="global_localization"):
    """Localization begins anew anywhere on the map."""

    number: int
    origin: str = ""


class NoMotionUpdate(Struct, frozen=True, tag_field="kind", tag="nomotion_update"):
    """The next scan is an update."""

    number: int
    origin: str = ""


class NewMap(Struct, frozen=True, tag_field="kind", tag="new_map"):
    """Another map to be localized on, without a pose.

    Attributes:
        number: of this request in its session.
        path: of the map.
        sha256: of what it held then.
        origin: who asked.
    """

    number: int
    path: str
    sha256: str
    origin: str = ""


class SetMap(Struct, frozen=True, tag_field="kind", tag="set_map"):
    """Another map to be localized on, and a pose: both or neither. Attributes as of the parts."""

    number: int
    path: str
    sha256: str
    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Covariance9
    frame: str
    origin: str = ""


class Gap(Struct, frozen=True, tag_field="kind", tag="gap"):
    """Bytes are missing before the next ones of a link; also where those begin a new file."""

    link: str


class Skip(Struct, frozen=True, tag_field="kind", tag="skip"):
    """The next bytes of a link were recorded but not mapped: there was no room for them."""

    link: str
    bytes: int


class Drop(Struct, frozen=True, tag_field="kind", tag="drop"):
    """A ping was not mapped, as it had waited for too long."""

    ping: int


class RemovedRemark(Struct, frozen=True, tag_field="kind", tag="error_bound"):
    """A remark of earlier versions about a setting that was removed; it has no effect."""


Request = InitialPose | GlobalLocalization | NoMotionUpdate | NewMap | SetMap
"""What localization is asked for."""

Decision = Session | Settings | Reset | ResetFailed | Gap | Skip | Drop | RemovedRemark | Request

_DECODER: msgspec.msgpack.Decoder[Decision] = msgspec.msgpack.Decoder(Decision)


def chunk_of(decision: Decision, t_ns: int) -> Chunk:
    """A decision as it is recorded."""
    return Chunk(LINK, DECISIONS, t_ns, msgspec.msgpack.encode(decision))


def decision_of(chunk: Chunk) -> Decision | None:
    """The decision in a chunk; None where there is none, or one of a later version."""
    if chunk.encoding != DECISIONS:
        return None
    try:
        return _DECODER.decode(chunk.data)
    except msgspec.DecodeError:
        return None


def is_remark(decision: Decision | None) -> bool:
    """Whether it is about what came before it, so that its place in the stream says nothing."""
    return isinstance(decision, Drop | RemovedRemark | ResetFailed)


@dataclass(frozen=True, slots=True)
class Remarks:
    """All remarks of one session.

    Attributes:
        drops: numbers of the pings that were dropped.
        failed: numbers of the resets that could not be carried out.
    """

    drops: frozenset[int] = frozenset()
    failed: frozenset[int] = frozenset()


def remarks_in(chunks: Iterable[Chunk]) -> Remarks:
    """Collect the remarks of a session; reads it to its end."""
    drops: set[int] = set()
    failed: set[int] = set()
    for chunk in chunks:
        match decision_of(chunk):
            case Drop(ping):
                drops.add(ping)
            case ResetFailed(number):
                failed.add(number)
    return Remarks(frozenset(drops), frozenset(failed))


def without_skipped(chunks: Iterable[Chunk]) -> Iterator[Chunk]:
    """Leave out the bytes that a `Skip` before them names."""
    skips: dict[str, int] = {}
    for chunk in chunks:
        decision = decision_of(chunk)
        if isinstance(decision, Skip):
            skips[decision.link] = skips.get(decision.link, 0) + decision.bytes
        left = skips.get(chunk.link, 0)
        if left and decision is None:
            skips[chunk.link] = left - len(chunk.data)  # the log may cut pieces, never join them
        else:
            yield chunk
