"""Decisions of the daemon that the sensor bytes do not determine, recorded beside them.

They form one more link of a recording, with one msgpack map per chunk. *Orders* take effect with
the next bytes of the stream. *Remarks* follow the bytes they describe and name the ping by number:
the first ping of a session is number 0, and every ping message counts.
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
    "STUCK",
    "ClockSet",
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
    "obeyed",
    "remarks_in",
    "without_skipped",
]

LINK = "mapperd"
SESSION = "session"
"""Key of the session's id in the metadata of its recordings."""

DECISIONS = "mapperd-decisions"
"""Encoding of the link."""

STUCK = "store_stuck"
"""Reason for which a map on disk takes no more pings: it cannot be saved."""

Covariance9 = tuple[float, float, float, float, float, float, float, float, float]
"""Covariance of x, y and yaw, row by row."""

Numbers12 = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float
]
"""x, y, yaw, and their covariance."""


class Session(Struct, frozen=True, tag_field="kind", tag="session"):
    """Start of a run of the daemon.

    Attributes:
        id: id of the run.
        version: version of mapperd.
        settings: all settings as plain values.
        pose: x, y, z in metres and w, x, y, z of a fixed vehicle; None uses odometry.
        saved_pose: initial estimate of localization, if any.
        map_sha256: digest of localization's first map; empty without one.
    """

    id: str
    version: str
    settings: dict[str, Any]
    pose: tuple[float, float, float, float, float, float, float] | None = None
    saved_pose: Numbers12 | None = None
    map_sha256: str = ""


class Settings(Struct, frozen=True, tag_field="kind", tag="settings"):
    """Settings that change here, by name, and who requested it."""

    values: dict[str, Any]
    origin: str = ""


class Reset(Struct, frozen=True, tag_field="kind", tag="reset"):
    """The map was emptied: it holds no ping whose pose was resolved before.

    Attributes:
        number: number of this reset in its session.
        origin: who requested it.
    """

    number: int
    origin: str = ""


class ResetFailed(Struct, frozen=True, tag_field="kind", tag="reset_failed"):
    """A reset failed: the map is unchanged."""

    number: int


class InitialPose(Struct, frozen=True, tag_field="kind", tag="initial_pose"):
    """Localization starts at a pose.

    Attributes:
        number: number of this request in its session.
        x_m, y_m, yaw_rad: mean.
        covariance: symmetric, positive semi-definite; m2, m rad, rad2.
        frame: frame of the pose.
        origin: who requested it.
    """

    number: int
    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Covariance9
    frame: str
    origin: str = ""


class GlobalLocalization(Struct, frozen=True, tag_field="kind", tag="global_localization"):
    """Localization starts with particles over the whole map."""

    number: int
    origin: str = ""


class NoMotionUpdate(Struct, frozen=True, tag_field="kind", tag="nomotion_update"):
    """The next scan updates the filter even without motion."""

    number: int
    origin: str = ""


class NewMap(Struct, frozen=True, tag_field="kind", tag="new_map"):
    """Localization switches to another map, without a pose.

    Attributes:
        number: number of this request in its session.
        path: path of the map.
        sha256: digest of its contents.
        origin: who requested it.
    """

    number: int
    path: str
    sha256: str
    origin: str = ""


class SetMap(Struct, frozen=True, tag_field="kind", tag="set_map"):
    """Localization switches to another map and pose. Attributes as in `NewMap`, `InitialPose`."""

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
    """Bytes are missing before the next chunk of a link, or that chunk begins a new file."""

    link: str


class Skip(Struct, frozen=True, tag_field="kind", tag="skip"):
    """The next bytes of a link were recorded but not mapped, because the queue was full."""

    link: str
    bytes: int


class Drop(Struct, frozen=True, tag_field="kind", tag="drop"):
    """A ping was not mapped.

    Attributes:
        ping: its number.
        reason: `store_stuck`: the map could not be saved, and took no more; the ping still reached
            localization. Empty: it had waited too long, and reached nothing.
    """

    ping: int
    reason: str = ""


class ClockSet(Struct, frozen=True, tag_field="kind", tag="clock_set"):
    """The host's clock was set; the stamps of this session keep the clock of its start.

    Attributes:
        offset_ns: host's clock minus the clock of the stamps, from here on.
    """

    offset_ns: int


class RemovedRemark(Struct, frozen=True, tag_field="kind", tag="error_bound"):
    """A remark of earlier versions about a removed setting; ignored."""


Request = InitialPose | GlobalLocalization | NoMotionUpdate | NewMap | SetMap
"""Requests to localization."""

Remark = Drop | ResetFailed | ClockSet | RemovedRemark
"""Decisions that follow what they describe."""

Decision = Session | Settings | Reset | Gap | Skip | Remark | Request

_DECODER: msgspec.msgpack.Decoder[Decision] = msgspec.msgpack.Decoder(Decision)


def chunk_of(decision: Decision, t_ns: int) -> Chunk:
    """Encode a decision for the recording."""
    return Chunk(LINK, DECISIONS, t_ns, msgspec.msgpack.encode(decision))


def decision_of(chunk: Chunk) -> Decision | None:
    """Decode the decision of a chunk; None for other chunks and decisions of later versions."""
    if chunk.encoding != DECISIONS:
        return None
    try:
        return _DECODER.decode(chunk.data)
    except ValueError:  # malformed, or text that is not UTF-8
        return None


def obeyed(chunk: Chunk) -> Decision | None:
    """Decode a decision that is to be carried out; None if the chunk fails its checksum.

    A `Gap` is carried out all the same: it only keeps pieces of messages apart.
    """
    decision = decision_of(chunk)
    return None if chunk.damaged and not isinstance(decision, Gap) else decision


def is_remark(decision: Decision | None) -> bool:
    """Return whether a decision is a remark, whose position in the stream has no meaning."""
    return isinstance(decision, Remark)


@dataclass(frozen=True, slots=True)
class Remarks:
    """All remarks of one session.

    Attributes:
        drops: numbers of the pings that had waited too long.
        failed: numbers of the failed resets.
        stuck: numbers of the pings that the map did not take because it could not be saved.
    """

    drops: frozenset[int] = frozenset()
    failed: frozenset[int] = frozenset()
    stuck: frozenset[int] = frozenset()


def remarks_in(chunks: Iterable[Chunk]) -> Remarks:
    """Collect the intact remarks of a session, reading it to its end."""
    drops: set[int] = set()
    stuck: set[int] = set()
    failed: set[int] = set()
    for chunk in chunks:
        match obeyed(chunk):
            case Drop(ping, reason):
                (stuck if reason == STUCK else drops).add(ping)
            case ResetFailed(number):
                failed.add(number)
    return Remarks(frozenset(drops), frozenset(failed), frozenset(stuck))


def without_skipped(chunks: Iterable[Chunk]) -> Iterator[Chunk]:
    """Leave out the bytes that a preceding, intact `Skip` names."""
    skips: dict[str, int] = {}
    for chunk in chunks:
        decision = obeyed(chunk)
        if isinstance(decision, Skip):
            skips[decision.link] = skips.get(decision.link, 0) + decision.bytes
        left = skips.get(chunk.link, 0)
        if left and chunk.encoding != DECISIONS:
            skips[chunk.link] = left - len(chunk.data)  # the log may cut pieces, never join them
        else:
            yield chunk
