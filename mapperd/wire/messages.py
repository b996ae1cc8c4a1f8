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
    "MapInfo",
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
"""Cells of level n are cubes with an edge of 2**n voxels."""

MAX_BLOCKS = 2048
"""Blocks of one message."""

MAX_FROM_SERVER = 4 << 20
"""Bytes of a message, without its length."""

MAX_FROM_CLIENT = 64 << 10

MAX_PATH = 100_000
"""Points of a path, in all of its pieces."""

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
    """A message; readers ignore unknown keys, so that later versions may add some."""


class MapBox(Struct, frozen=True, forbid_unknown_fields=True):
    """A box with its edges along the map's axes."""

    low_m: Vector
    high_m: Vector


class Interest(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The part of the map that a client gets, and its detail.

    Attributes:
        level: cells are cubes with an edge of 2**level voxels.
        detail: `classes` has unknown, free and occupied only; `log_odds` has quantised log-odds;
            `counts` has the numbers of observations too.
        radius_m: around the vehicle; 0 has no limit.
        box: limits the part further; None has no limit.
    """

    level: Annotated[int, Meta(ge=0, le=MAX_LEVEL)] = 0
    detail: Literal["classes", "log_odds", "counts"] = "log_odds"
    radius_m: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    box: MapBox | None = None


class Resume(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a client holds already.

    Attributes:
        map: id of the map that it holds.
        session: of the daemon that sent `revision`.
        revision: revision up to which its interest was last complete; None if it never was.
        level, detail, radius_m, box: the interest that it holds.
        newest: highest revision of all messages about the map that it used; None if unknown.
        path: number of points of the path that it holds.
        path_version: version of these points.
        ticket: of the previous connection's welcome; "" without one.
        bytes: of the previous connection that were used, as `AckMessage` counts them.
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
        version: of the protocol.
        proof: proves that the client knows the token; "" without a token.
        name: of the program, for people.
        wants: kinds of messages.
        interest: part of the map.
        bytes_per_s: limit of the rate; 0 has no limit.
        resume: what the client holds.
        events_since: number of the last event that it has; None requests new events only.
        beside: requests a second connection, as earlier clients do; the daemon refuses it.
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
    """Changes what a client wants; None keeps a value."""

    wants: Annotated[list[Want], Meta(max_length=32)] | None = None
    interest: Interest | None = None
    bytes_per_s: Annotated[int, Meta(ge=0, le=1 << 40)] | None = None


class AckMessage(WireMessage, frozen=True, kw_only=True):
    """Acknowledges bytes of this connection that were used, including the lengths of messages."""

    bytes: Count


class AskMessage(WireMessage, frozen=True, kw_only=True):
    """A request of docs/reference/control.md: `{"do": "set", "id": 7, "changes": {...}}`."""

    ask: msgspec.Raw


class GreetingMessage(WireMessage, frozen=True, kw_only=True, omit_defaults=False):
    """The first message of the daemon; it includes default values.

    Attributes:
        mapperd: name of the protocol.
        versions: of the protocol that the daemon supports.
        challenge: for the proof of the token; "" if no token is needed.
    """

    mapperd: str = PROTOCOL
    versions: tuple[int, ...] = (VERSION,)
    challenge: str = ""


class MapInfo(Struct, frozen=True):
    """Facts about a map.

    Attributes:
        id: of this map; it changes with a reset.
        resolution_m: edge of a voxel.
        log_odds_step: of the quantised log-odds.
        occupied_log_odds, free_log_odds: cells above the first are occupied, below the second free.
        frame: name of the frame of all coordinates.
        origin_deg: latitude and longitude of its zero, x east and y north; None if unknown.
        bricks_lost: damaged bricks of the map file, whose space is unknown.
        prior_log_odds: of an unobserved voxel by the arc rule; 0 by IWLO.
    """

    id: str
    resolution_m: Annotated[float, Meta(gt=0, le=1e3)]
    log_odds_step: Annotated[float, Meta(gt=0, le=10)]
    occupied_log_odds: float
    free_log_odds: float
    frame: str = "map"
    origin_deg: tuple[float, float] | None = None
    bricks_lost: Count = 0
    prior_log_odds: Annotated[float, Meta(ge=-7, le=0)] = 0.0


class WelcomeMessage(WireMessage, frozen=True, kw_only=True):
    """The answer to a valid hello.

    Attributes:
        version: of the protocol.
        server: version of mapperd.
        vehicle: name of the vehicle.
        session: of the daemon.
        map: facts about the map.
        revision: current revision of the map.
        resumed: the client keeps what it holds; otherwise it drops all blocks and the path.
        reason: why it does not.
        may_change: requests that change something are allowed.
        ticket: secret of this connection; a client that sends it resumes where this one broke.
    """

    version: int
    server: str
    vehicle: str
    session: str
    map: MapInfo
    revision: Count
    resumed: bool
    reason: str = ""
    may_change: bool = False
    ticket: Annotated[str, Meta(max_length=64)] = ""


class BlocksMessage(WireMessage, frozen=True, kw_only=True):
    """Current state of blocks of the map: `mapperd.wire.blocks`.

    Attributes:
        revision: of the map when they were read.
        stamp_ns: time when they were read.
        left: blocks that are still to be sent.
        complete: revision up to which these blocks complete the interest; None if they do not.
        body: a zstd frame; b"" without blocks.
    """

    revision: Count
    stamp_ns: Count
    left: Count = 0
    complete: Count | None = None
    body: bytes = b""


class ResetMessage(WireMessage, frozen=True, kw_only=True):
    """The client drops all blocks: the map, its facts or the interest changed.

    Attributes:
        map: facts about the map.
        revision: of the map.
        interest: that applies from now on; None is the newest one. A reset answers one or several
            changes of the interest.
    """

    map: MapInfo
    revision: Count
    interest: Interest | None = None


class PoseMessage(WireMessage, frozen=True, kw_only=True):
    """Pose of the vehicle: its base and its sonar in the map frame.

    Attributes:
        stamp_ns: time of the pose.
        position_m: of the base.
        orientation_xyzw: rotation from the base frame to the map frame.
        velocity_mps: of the base, map frame; None if unknown.
        sonar_position_m, sonar_orientation_xyzw: of the sonar.
        covariance: (6, 6) row by row, x y z and rotations about the map's axes, metres and
            radians; None if unknown.
        source: `odometry`, `localization` or `fixed`.
        odom_position_m, odom_orientation_xyzw: the base in the odometry's frame at the same time;
            None where that frame is the map, or its pose is unknown.
    """

    stamp_ns: Count
    position_m: Vector
    orientation_xyzw: Quaternion
    sonar_position_m: Vector
    sonar_orientation_xyzw: Quaternion
    velocity_mps: Vector | None = None
    covariance: Annotated[tuple[float, ...], Meta(min_length=36, max_length=36)] | None = None
    source: str = "odometry"
    odom_position_m: Vector | None = None
    odom_orientation_xyzw: Quaternion | None = None


class PathMessage(WireMessage, frozen=True, kw_only=True):
    """A piece of the vehicle's path.

    Attributes:
        first: number of the first point; the client drops its points from there on.
        points: float32 (N, 3), metres, map frame.
        version: counts up when a long path is thinned, which changes the numbers of its points.
        rest: float32 (N, 3), metres: rounding errors of the points; b"" if negligible.
    """

    first: Count
    points: bytes
    version: Count = 0
    rest: bytes = b""


class FanMessage(WireMessage, frozen=True, kw_only=True):
    """Field of view of the sonar, in its own frame (x forward, y port, z up).

    Attributes:
        bearings_rad: outermost bearings, positive to starboard.
        vertical_aperture_rad: full angle.
        min_range_m, max_range_m: limits of the range.
    """

    bearings_rad: tuple[float, float]
    vertical_aperture_rad: float
    min_range_m: float
    max_range_m: float


class ReturnsMessage(WireMessage, frozen=True, kw_only=True):
    """First returns of the beams of one ping.

    Attributes:
        stamp_ns: time when the ping was complete.
        ping_id: number of the ping, from the sonar.
        sonar_position_m, sonar_orientation_xyzw: pose of the sonar, map frame; None if unknown.
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
    """The image of a ping, reduced for display.

    Attributes:
        stamp_ns, ping_id: as in `ReturnsMessage`.
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
    """Other robots that were detected lately: (time in ns, x, y, z), map frame."""

    seen: list[tuple[int, float, float, float]]


class LocalizationMessage(WireMessage, frozen=True, kw_only=True):
    """State of the localization.

    Attributes:
        report: plain values, as the answer to `localization` of docs/reference/control.md.
        particles: float32 (N, 4): x, y in metres, yaw in radians, weight; map frame.
        scan: float32 (M, 3): points of the last scan, metres, map frame.
    """

    report: dict[str, Any]
    particles: bytes = b""
    scan: bytes = b""


class StatusMessage(WireMessage, frozen=True, kw_only=True):
    """Heartbeat, once a second for every client.

    Attributes:
        stamp_ns: current time.
        status: as the answer to `status` of docs/reference/control.md; empty for clients that do
            not want `status`.
        link: of this client: `bytes`, `bytes_per_s`, `round_trip_s`, `in_flight`, `left` (blocks
            still to be sent), `skipped` (messages that were not sent, by kind).
    """

    stamp_ns: Count
    status: dict[str, Any] = field(default_factory=dict)
    link: dict[str, Any] = field(default_factory=dict)


class EventMessage(WireMessage, frozen=True, kw_only=True):
    """An event; `lost` is the number of forgotten events before it."""

    event: dict[str, Any]
    lost: Count = 0


class SettingsMessage(WireMessage, frozen=True, kw_only=True):
    """Settings: all of them at first, then those that changed.

    Attributes:
        facts: name to facts, as the answer to `params` of docs/reference/control.md.
    """

    facts: dict[str, Any]


class AnswerMessage(WireMessage, frozen=True, kw_only=True):
    """The answer to a request: docs/reference/control.md."""

    id: int | None = None
    result: dict[str, Any] | None = None
    error: dict[str, Any] | None = None


class ByeMessage(WireMessage, frozen=True, kw_only=True):
    """The last message, with the reason."""

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
