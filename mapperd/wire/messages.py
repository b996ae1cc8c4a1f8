"""Messages of clients and the daemon: docs/reference/map-stream.md.

Each message is one MessagePack map whose key `t` names its kind; times are Unix nanoseconds,
lengths metres, angles radians, arrays bytes in little endian.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct, field

__all__ = [
    "BLOCK_EDGE",
    "MAX_BLOCKS",
    "MAX_FROM_CLIENT",
    "MAX_FROM_SERVER",
    "MAX_LEVEL",
    "MAX_PATH",
    "MAX_SETTINGS",
    "PROTOCOL",
    "VERSION",
    "WANTS",
    "AckMessage",
    "AnswerMessage",
    "AskMessage",
    "BlocksMessage",
    "ByeMessage",
    "ChangeMessage",
    "Count",
    "EventMessage",
    "FanMessage",
    "FromClient",
    "FromServer",
    "GreetingMessage",
    "HelloMessage",
    "ImageMessage",
    "Interest",
    "LocalizationMessage",
    "MapBox",
    "MapFacts",
    "Name",
    "PathMessage",
    "PoseMessage",
    "Quaternion",
    "ResetMessage",
    "Resume",
    "ReturnsMessage",
    "RobotsMessage",
    "SettingsMessage",
    "StatusMessage",
    "Vector",
    "Want",
    "WelcomeMessage",
    "WireMessage",
]

PROTOCOL, VERSION = "map stream", 1
BLOCK_EDGE = 8
"""Cells along one edge of a block of the stream."""

MAX_LEVEL = 3
"""Cells of level n are cubes of 2**n voxels along an edge."""

MAX_BLOCKS = 2048
"""In one message."""

MAX_FROM_SERVER = 4 << 20
"""Bytes of a message, its length not counted."""

MAX_FROM_CLIENT = 64 << 10

MAX_PATH = 100_000
"""Points of a path, all pieces together."""

MAX_SETTINGS = 10_000

Want = Literal[
    "map",
    "pose",
    "path",
    "fan",
    "returns",
    "image",
    "robots",
    "localization",
    "status",
    "events",
    "settings",
]
WANTS: tuple[Want, ...] = Want.__args__  # type: ignore[attr-defined]

Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(max_length=100)]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def _tag(name: str) -> str:
    return name.removesuffix("Message").lower()


class WireMessage(Struct, frozen=True, kw_only=True, tag_field="t", tag=_tag, omit_defaults=True):
    """Unknown keys are passed over, so that a later version may say more."""


class MapBox(Struct, frozen=True, forbid_unknown_fields=True):
    """A box with its edges along the map's axes."""

    low_m: Vector
    high_m: Vector


class Interest(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Which part of the map a client is sent, and how finely.

    Attributes:
        level: cells are cubes of 2**level voxels.
        detail: `classes` tells unknown, free and occupied alone; `log_odds` their quantised
            log-odds too, `counts` also how often cells were observed.
        radius_m: around the vehicle; 0 has no limit.
        box: and inside this; None has no limit.
    """

    level: Annotated[int, Meta(ge=0, le=MAX_LEVEL)] = 0
    detail: Literal["classes", "log_odds", "counts"] = "log_odds"
    radius_m: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    box: MapBox | None = None


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
        bytes: of that connection that were read and used, as `AckMessage` counts them.
    """

    map: Name
    session: Name
    revision: Count | None = None
    level: int = 0
    detail: str = "log_odds"
    radius_m: float = 0.0
    box: MapBox | None = None
    newest: Count | None = None
    path: Count = 0
    path_version: Count = 0
    ticket: Annotated[str, Meta(max_length=64)] = ""
    bytes: Count = 0


class HelloMessage(WireMessage, frozen=True, kw_only=True):
    """The first message of a client.

    Attributes:
        version: that is to be spoken.
        proof: that the token is known; "" without one.
        name: of the program, for people.
        wants: kinds of messages.
        interest: in the map.
        bytes_per_s: at most; 0 leaves it to the link.
        resume: what the client holds.
        events_since: number of the last event that it has; None requests new ones alone.
        beside: earlier clients asked for a second connection by it, which is refused.
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


class ChangeMessage(WireMessage, frozen=True, kw_only=True):
    """Something else is wanted from now on; what is None stays."""

    wants: Annotated[list[Want], Meta(max_length=32)] | None = None
    interest: Interest | None = None
    bytes_per_s: Annotated[int, Meta(ge=0, le=1 << 40)] | None = None


class AckMessage(WireMessage, frozen=True, kw_only=True):
    """So many bytes of this connection have been read and used, the lengths of messages too."""

    bytes: Count


class AskMessage(WireMessage, frozen=True, kw_only=True):
    """A request of docs/reference/control.md: `{"do": "set", "id": 7, "changes": {...}}`."""

    ask: msgspec.Raw


class GreetingMessage(WireMessage, frozen=True, kw_only=True, omit_defaults=False):
    """The first message of the daemon; it says everything, to those who know nothing yet.

    Attributes:
        mapperd: what this is.
        versions: that it speaks.
        challenge: to be answered by the proof of the token; without one none is needed.
    """

    mapperd: str = PROTOCOL
    versions: tuple[int, ...] = (VERSION,)
    challenge: str = ""


class MapFacts(Struct, frozen=True):
    """What is the same for all of a map.

    Attributes:
        id: of this map; another one after a reset.
        resolution_m: edge of a voxel.
        log_odds_step: of the quantised log-odds.
        occupied_log_odds, free_log_odds: occupied is above the one, free below the other.
        frame: name of the frame of all coordinates.
        origin_deg: latitude and longitude of its zero, x east and y north; None where unknown.
        bricks_lost: damaged bricks of the map file, whose space is unknown.
    """

    id: str
    resolution_m: Annotated[float, Meta(gt=0, le=1e3)]
    log_odds_step: Annotated[float, Meta(gt=0, le=10)]
    occupied_log_odds: float
    free_log_odds: float
    frame: str = "map"
    origin_deg: tuple[float, float] | None = None
    bricks_lost: Count = 0


class WelcomeMessage(WireMessage, frozen=True, kw_only=True):
    """The answer to a hello that is good.

    Attributes:
        version: that is spoken.
        server: version of mapperd.
        vehicle: its name.
        session: of the daemon.
        map: that is served.
        revision: of the map now.
        resumed: what the client holds is good; otherwise it forgets all blocks and the path.
        reason: why not.
        may_change: requests that change something are obeyed.
        ticket: a secret of this connection; whoever shows it goes on where this one broke.
    """

    version: int
    server: str
    vehicle: str
    session: str
    map: MapFacts
    revision: Count
    resumed: bool
    reason: str = ""
    may_change: bool = False
    ticket: Annotated[str, Meta(max_length=64)] = ""


class BlocksMessage(WireMessage, frozen=True, kw_only=True):
    """Blocks of the map as they are now: `mapperd.wire.blocks`.

    Attributes:
        revision: of the map that they are of.
        stamp_ns: when they were so.
        left: blocks that are still to be sent.
        complete: with these, all of the interest is as of this revision; None while it is not.
        body: a zstd frame; b"" is no block.
    """

    revision: Count
    stamp_ns: Count
    left: Count = 0
    complete: Count | None = None
    body: bytes = b""


class ResetMessage(WireMessage, frozen=True, kw_only=True):
    """All blocks are forgotten: the map is another one, or is sent in another way from now on.

    Attributes:
        map: that is sent.
        revision: of it.
        interest: that is sent. Each change of a client's interest is answered by a reset, or
            several at once: only this says which one is heeded. None is the newest one.
    """

    map: MapFacts
    revision: Count
    interest: Interest | None = None


class PoseMessage(WireMessage, frozen=True, kw_only=True):
    """Where the vehicle is: its base and its sonar in the map's frame.

    Attributes:
        stamp_ns: of the pose.
        position_m: of the base.
        orientation_xyzw: takes base coordinates to the map's.
        velocity_mps: of the base, map frame; None where unknown.
        sonar_position_m, sonar_orientation_xyzw: of the sonar.
        covariance: (6, 6) row by row, x y z and turns about the map's axes, metres and radians;
            None where nobody knows it.
        source: `odometry`, `localization` or `fixed`.
    """

    stamp_ns: Count
    position_m: Vector
    orientation_xyzw: Quaternion
    sonar_position_m: Vector
    sonar_orientation_xyzw: Quaternion
    velocity_mps: Vector | None = None
    covariance: Annotated[tuple[float, ...], Meta(min_length=36, max_length=36)] | None = None
    source: str = "odometry"


class PathMessage(WireMessage, frozen=True, kw_only=True):
    """A piece of the way that the vehicle has come.

    Attributes:
        first: number of the first of these points; what the client holds from there on is old.
        points: float32 (N, 3), metres, map frame.
        version: counts up when a long path is thinned, which numbers its points again.
        rest: float32 (N, 3), metres: what rounding left of the points; b"" where next to nothing.
    """

    first: Count
    points: bytes
    version: Count = 0
    rest: bytes = b""


class FanMessage(WireMessage, frozen=True, kw_only=True):
    """The water that the sonar looks at, in its own frame (x forward, y port, z up).

    Attributes:
        bearings_rad: the outermost ones, positive to starboard.
        vertical_aperture_rad: full.
        min_range_m, max_range_m: between which it sees.
    """

    bearings_rad: tuple[float, float]
    vertical_aperture_rad: float
    min_range_m: float
    max_range_m: float


class ReturnsMessage(WireMessage, frozen=True, kw_only=True):
    """What one ping met: the first return of each beam that has one.

    Attributes:
        stamp_ns: when it was complete.
        ping_id: the sonar's number of it.
        sonar_position_m, sonar_orientation_xyzw: then, in the map.
        outcome: `mapped`, or why the ping is not in the map.
        points: float32 (N, 3), metres, sonar frame, in the plane of the fan.
        intensities: uint8 (N,).
    """

    stamp_ns: Count
    ping_id: int
    sonar_position_m: Vector | None = None
    sonar_orientation_xyzw: Quaternion | None = None
    outcome: str = "mapped"
    points: bytes = b""
    intensities: bytes = b""


class ImageMessage(WireMessage, frozen=True, kw_only=True):
    """The image of a ping, no finer than a person sees.

    Attributes:
        stamp_ns, ping_id: as those of `ReturnsMessage`.
        rows, beams: of the image; row 0 is nearest, column 0 the most negative bearing.
        range_resolution_m: thickness of a row.
        bearings_rad: float32 (beams,), positive to starboard.
        body: uint8 (rows, beams), a zstd frame.
    """

    stamp_ns: Count
    ping_id: int
    rows: Annotated[int, Meta(ge=1, le=4096)]
    beams: Annotated[int, Meta(ge=1, le=1024)]
    range_resolution_m: float
    bearings_rad: bytes
    body: bytes


class RobotsMessage(WireMessage, frozen=True, kw_only=True):
    """Other robots that were seen lately: (time in ns, x, y, z) in the map's frame."""

    seen: list[tuple[int, float, float, float]]


class LocalizationMessage(WireMessage, frozen=True, kw_only=True):
    """As the answer to `localization` of docs/reference/control.md says it.

    Attributes:
        report: plain values.
        particles: float32 (N, 4): x, y in metres, yaw in radians, weight; map frame.
        scan: float32 (M, 3): points of the last scan, metres, map frame.
    """

    report: dict[str, Any]
    particles: bytes = b""
    scan: bytes = b""


class StatusMessage(WireMessage, frozen=True, kw_only=True):
    """How it goes, once a second, whether it is wanted or not; without `status` it is empty.

    Attributes:
        stamp_ns: now.
        status: as the answer to `status` of docs/reference/control.md.
        link: of this client: `bytes`, `bytes_per_s`, `round_trip_s`, `in_flight`, `left` (blocks
            still to be sent), `skipped` (kind of message to those that were too much).
    """

    stamp_ns: Count
    status: dict[str, Any] = field(default_factory=dict)
    link: dict[str, Any] = field(default_factory=dict)


class EventMessage(WireMessage, frozen=True, kw_only=True):
    """Something happened; `lost` are those before it that nobody remembers."""

    event: dict[str, Any]
    lost: Count = 0


class SettingsMessage(WireMessage, frozen=True, kw_only=True):
    """Settings and all about them: the first time all, then those that changed.

    Attributes:
        facts: name to facts, as the answer to `params` of docs/reference/control.md.
    """

    facts: dict[str, Any]


class AnswerMessage(WireMessage, frozen=True, kw_only=True):
    """What became of a request, as docs/reference/control.md says."""

    id: int | None = None
    result: dict[str, Any] | None = None
    error: dict[str, Any] | None = None


class ByeMessage(WireMessage, frozen=True, kw_only=True):
    """The last message, and why it is."""

    reason: str
    message: str = ""


FromClient = HelloMessage | ChangeMessage | AckMessage | AskMessage
FromServer = (
    GreetingMessage
    | WelcomeMessage
    | BlocksMessage
    | ResetMessage
    | PoseMessage
    | PathMessage
    | FanMessage
    | ReturnsMessage
    | ImageMessage
    | RobotsMessage
    | LocalizationMessage
    | StatusMessage
    | EventMessage
    | SettingsMessage
    | AnswerMessage
    | ByeMessage
)
