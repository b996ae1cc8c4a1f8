"""Settings of the odometry: its sources, its formats, the pose at a ping's time.

`LinkAddress` is where a link's bytes come from, as one text:

| text | meaning |
|---|---|
| `udp://ADDRESS:PORT` | listen for datagrams at an address of this host |
| `tcp://HOST:PORT` | connect to a sender, and again when it is lost |
| `socket://HOST:PORT` | the same: a serial line behind a network converter |
| `serial:/dev/ttyUSB0?baud=115200` | a serial line by its path |
| `serial:NAME?baud=115200` | by the name that udev gives it under /dev/serial/by-id or by-path |
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = [
    "FIXED",
    "NOBODY",
    "SONAR",
    "DeadReckoningConfig",
    "FormatName",
    "FormatSettings",
    "GeoOriginConfig",
    "LimitsConfig",
    "LinkAddress",
    "OdometryFusionConfig",
    "OwnersConfig",
    "SlamQualityConfig",
    "SonarOdometryConfig",
    "TimeSyncConfig",
    "WorldInitConfig",
    "parse_address",
    "serial_path",
]

MAX_BAUD = 4_000_000
DEFAULT_BAUD = 115_200
HOST_PORT = re.compile(
    # No name has an empty part or one of more than 63 letters: looking it up would raise.
    r"^(?P<host>(?=[^:]{1,253}:)[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*\.?"
    r"|\[[0-9A-Fa-f:]{2,39}\]):(?P<port>[0-9]{1,5})$"
)
UDEV_NAME = re.compile(r"^[A-Za-z0-9#+\-.:=@_]{1,255}$")
UDEV_FOLDERS = (Path("/dev/serial/by-id"), Path("/dev/serial/by-path"))


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """One place that bytes come from.

    Attributes:
        kind: how it is opened.
        host, port: of networks.
        device: of serial lines, a path or a name of udev's.
        baud: of serial lines.
    """

    kind: Literal["udp", "tcp", "serial"]
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = DEFAULT_BAUD

    def __str__(self) -> str:
        """For a person."""
        return (
            self.device if self.kind == "serial" else f"{self.kind.upper()} {self.host}:{self.port}"
        )


def parse_address(text: str) -> LinkAddress:
    """Read the text of a link.

    Raises:
        ValueError: it is invalid; the message states what is allowed.
    """
    scheme, _, rest = text.partition(":")
    if scheme == "serial":
        return _serial(rest, text)
    if scheme not in ("udp", "tcp", "socket") or not rest.startswith("//"):
        raise ValueError(
            f"{text!r} is not a link; allowed: udp://ADDRESS:PORT, tcp://HOST:PORT, "
            "socket://HOST:PORT, serial:/dev/NAME?baud=115200 or serial:UDEV_NAME"
        )
    found = HOST_PORT.match(rest[2:])
    if found is None or not 1 <= int(found["port"]) <= 65535:  # noqa: PLR2004 a port is 16 bits
        raise ValueError(
            f"{text!r} lacks a host or a port from 1 to 65535; such as {scheme}://127.0.0.1:52200"
        )
    kind: Literal["udp", "tcp"] = "udp" if scheme == "udp" else "tcp"
    return LinkAddress(kind, found["host"].strip("[]"), int(found["port"]))


def serial_path(device: str) -> Path:
    """Return the path of a serial line; udev names are resolved, as they change when replugged.

    Raises:
        FileNotFoundError: nothing of that name is plugged in.
    """
    if device.startswith("/"):
        return Path(device)
    for folder in UDEV_FOLDERS:
        if (folder / device).exists():
            return folder / device
    raise FileNotFoundError(
        f"no {device!r} under {' or '.join(map(str, UDEV_FOLDERS))}: is it plugged in?"
    )


def _serial(rest: str, text: str) -> LinkAddress:
    device, _, query = rest.removeprefix("//").partition("?")
    by_path = device.startswith("/dev/") and ".." not in device
    if not by_path and not UDEV_NAME.match(device):
        raise ValueError(
            f"{text!r} names no serial line; allowed: a path under /dev, or udev's name of it"
        )
    baud = query.removeprefix("baud=") if query else str(DEFAULT_BAUD)
    if not baud.isdecimal() or not 1 <= int(baud[:10]) <= MAX_BAUD:
        raise ValueError(
            f"{text!r} has no baud rate; such as ?baud={DEFAULT_BAUD}, at most {MAX_BAUD}"
        )
    return LinkAddress("serial", device=device, baud=int(baud))


FormatName = Literal[
    "native",
    "native_json",
    "native_serial",
    "mavlink",
    "water_linked_json",
    "water_linked_serial",
    "nmea",
]


class FormatSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """One source's format."""

    format: Annotated[FormatName, rule("Format of the bytes: docs/guides/odometry.md.")] = "native"
    mavlink_system_id: Annotated[
        int, rule("Accept only this MAVLink system; 0 accepts all.", ge=0, le=255)
    ] = 1
    mavlink_component_id: Annotated[
        int, rule("Accept only this component of it; 0 accepts all.", ge=0, le=255)
    ] = 1
    water_density: Annotated[
        float,
        rule("Turns pressure into depth: sea 1025, fresh water 998.", "kg/m3", ge=900, le=1300),
    ] = 1025.0
    surface_pressure: Annotated[
        float, rule("Air pressure at the surface.", "hPa", ge=500, le=1100)
    ] = 1013.25


NAME_PATTERN = "[A-Za-z0-9_.-]{1,32}"

NOBODY = "none"
"""As an owner: this quantity is taken from no source."""

FIXED = "fixed"
"""As the owner of the position: the vehicle stays at one spot, x = y = 0."""

Name = Annotated[
    str,
    rule(
        "Name of a source; empty selects the first one that provides it, none disables it.",
        "a name, none, or nothing",
        pattern=f"^({NAME_PATTERN})?$",
    ),
]


class TimeSyncConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The pose at a ping's time."""

    policy: Annotated[
        Literal["interpolate", "nearest", "latest"],
        rule(
            "interpolate: between the records around the ping; nearest: the record nearest in "
            "time; latest: the newest one.",
            live=True,
        ),
    ] = "interpolate"
    max_gap_sec: Annotated[
        float,
        rule("Poses are interpolated over at most this.", "s", live=True, gt=0, le=60),
    ] = 0.5
    max_stamp_diff_sec: Annotated[
        float,
        rule(
            "Where no such gap encloses the ping, motion is carried on this far; then it drops. "
            "With the other policies: the largest difference between record and ping.",
            "s",
            live=True,
            ge=0,
            le=10,
        ),
    ] = 0.1
    max_odom_age_sec: Annotated[
        float,
        rule(
            "A record stamped further than this from its arrival is rejected.",
            "s",
            live=True,
            gt=0,
            le=3600,
        ),
    ] = 0.5


class SlamQualityConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Pings are mapped only while the source is confident, if it reports its confidence."""

    threshold: Annotated[float, rule("Minimum confidence.", "0-1", live=True, ge=0, le=1)] = 0.4
    fail_mode: Annotated[
        Literal["open", "closed"],
        rule("Without a fresh confidence, `open` maps the ping and `closed` drops it.", live=True),
    ] = "open"
    grace_period_sec: Annotated[
        float,
        rule(
            "Time after the first odometry during which no confidence is required.",
            "s",
            live=True,
            ge=0,
            le=3600,
        ),
    ] = 1.0
    stale_timeout_sec: Annotated[
        float,
        rule("A confidence older than this counts as missing.", "s", live=True, gt=0, le=3600),
    ] = 5.0


class OwnersConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Which source each quantity comes from: one each, so that nothing counts twice."""

    position: Annotated[
        str,
        rule(
            "Source of the position; empty selects the first one that provides it, none disables "
            "it, fixed maps from one spot: x and y are 0, attitude and depth are measured.",
            "a name, fixed, none, or nothing",
            pattern=f"^({NAME_PATTERN})?$",
        ),
    ] = ""
    attitude: Name = ""
    depth: Annotated[
        str,
        rule(
            "Source of the depth, which then overrides the height of positions; empty is the "
            "first that measures it, for positions that have no height of their own; none "
            "leaves it out.",
            "a name, none, or nothing",
            pattern=f"^({NAME_PATTERN})?$",
        ),
    ] = ""
    velocity: Name = ""


class LimitsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """What is too much for this vehicle: such a record is a fault, not a motion."""

    max_speed: Annotated[
        float, rule("Maximum speed of the vehicle.", "m/s", live=True, gt=0, le=1000)
    ] = 5.0
    max_turn_rate: Annotated[
        float, rule("Maximum turn rate about any axis.", "deg/s", live=True, gt=0, le=36000)
    ] = 180.0
    max_jump: Annotated[
        float,
        rule(
            "Maximum jump of the position beyond what the speed explains.",
            "m",
            live=True,
            gt=0,
            le=1e6,
        ),
    ] = 0.5
    max_jump_angle: Annotated[
        float,
        rule(
            "Maximum jump of the attitude beyond what the turn rate explains.",
            "deg",
            live=True,
            gt=0,
            le=180,
        ),
    ] = 10.0


class DeadReckoningConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The way on by velocity and attitude, where no position comes."""

    max_sec: Annotated[
        float,
        rule(
            "Maximum time of dead reckoning after the last position; 0 disables it. No limit "
            "applies without a source of positions.",
            "s",
            live=True,
            ge=0,
            le=86400,
        ),
    ] = 60.0
    noise: Annotated[
        float,
        rule(
            "Growth of the position's standard deviation if the source reports none.",
            "m/sqrt(s)",
            live=True,
            ge=0,
            le=100,
        ),
    ] = 0.05


class GeoOriginConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The map's zero on Earth."""

    latitude: Annotated[float, rule("North positive.", "deg", ge=-90, le=90)]
    longitude: Annotated[float, rule("East positive.", "deg", ge=-180, le=180)]


class OdometrySourceConfig(FormatSettings, frozen=True, forbid_unknown_fields=True):
    """One sender of odometry."""

    name: Annotated[
        str,
        rule(
            "Name of the source in owners, recordings and reports.",
            "a name",
            pattern=f"^{NAME_PATTERN}$",
        ),
    ] = "odometry"
    link: Annotated[
        str,
        rule(
            "Link of the source: udp://ADDRESS:PORT to listen, tcp://HOST:PORT to connect, "
            "socket://HOST:PORT, serial:/dev/NAME?baud=115200, serial:UDEV_NAME.",
            "a link",
            pattern="^(udp|tcp|socket|serial):.{1,300}$",
        ),
    ] = "udp://127.0.0.1:52200"
    latency_sec: Annotated[
        float,
        rule(
            "Minimum latency from measurement to arrival, which no clock fit can see.",
            "s",
            ge=0,
            le=10,
        ),
    ] = 0.0

    def __post_init__(self) -> None:
        """Check what no single field can.

        Raises:
            ValueError: the link is invalid, or cannot carry the format.
        """
        if self.format == "native" and parse_address(self.link).kind != "udp":
            raise ValueError(
                f"format native has no frames and needs datagrams, {self.link!r} is a stream; "
                "allowed: native_serial or native_json there, or udp://"
            )
        parse_address(self.link)


SONAR = "sonar"
"""Name of the source that sonar odometry is."""


class SonarOdometryConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Velocity over ground from consecutive pings, for a vehicle without a DVL."""

    enabled: Annotated[
        bool,
        rule(
            "Measure surge, sway and, if `owners.attitude` is `sonar`, yaw. The source is called "
            "`sonar`."
        ),
    ] = False
    max_speed: Annotated[
        float,
        rule(
            "Maximum speed of the vehicle; more of it finds more false matches.",
            "m/s",
            gt=0,
            le=5,
        ),
    ] = 1.5


class OdometryFusionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Fusion of the sources' records into one pose."""

    sources: Annotated[
        tuple[OdometrySourceConfig, ...],
        rule("Sources of odometry.", min_length=1, max_length=16),
    ] = (OdometrySourceConfig(),)
    owners: OwnersConfig = OwnersConfig()
    limits: LimitsConfig = LimitsConfig()
    dead_reckoning: DeadReckoningConfig = DeadReckoningConfig()
    sonar: SonarOdometryConfig = SonarOdometryConfig()
    at_jump: Annotated[
        Literal["continue", "follow"],
        rule(
            "After a jump of an estimate, `continue` keeps the vehicle's previous position "
            "and `follow` uses the source's new one. Either begins a new segment.",
            live=True,
        ),
    ] = "continue"
    origin: Annotated[
        GeoOriginConfig | None,
        rule("Origin of geographic positions; default: the map's first fix."),
    ] = None
    position_std: Annotated[
        float,
        rule(
            "Standard deviation of positions whose source reports none.",
            "m",
            live=True,
            gt=0,
            le=1e4,
        ),
    ] = 0.1
    attitude_std: Annotated[
        float,
        rule(
            "Standard deviation of attitudes whose source reports none.",
            "deg",
            live=True,
            gt=0,
            le=180,
        ),
    ] = 1.0

    def __post_init__(self) -> None:
        """Check what no single field can.

        Raises:
            ValueError: two sources share a name, an owner is no source, or a vehicle at a fixed
                spot has a source of velocity.
        """
        names = [source.name for source in self.sources]
        for word in (NOBODY, FIXED):
            if word in names:
                raise ValueError(f"a source cannot be called {word!r}: the owners have this word")
        if len(set(names)) < len(names):
            raise ValueError(f"two sources share a name: {', '.join(names)}; allowed: one each")
        if self.sonar.enabled:
            if SONAR in names:
                raise ValueError(
                    f"a source cannot be called {SONAR!r} while odometry.sonar is enabled"
                )
            names = [*names, SONAR]
        for quantity in ("position", "attitude", "depth", "velocity"):
            owner = getattr(self.owners, quantity)
            words = (NOBODY, FIXED) if quantity == "position" else (NOBODY,)
            if owner and owner not in (*names, *words):
                raise ValueError(
                    f"owners.{quantity} {owner!r} is no source; allowed: {', '.join(names)}, "
                    f"{', '.join(words)}"
                )
        if self.owners.position == FIXED and self.owners.velocity not in ("", NOBODY):
            raise ValueError(
                f"owners.position {FIXED} contradicts owners.velocity {self.owners.velocity!r}: a "
                "vehicle at a fixed spot does not move; allowed: one of them"
            )


class WorldInitConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Levelling of an odometry whose world leans: by gravity, while the vehicle stands still."""

    enabled: Annotated[bool, rule("Level the odometry before anything is mapped.")] = False
    init_samples: Annotated[
        int, rule("Number of accelerations that are averaged.", "records", ge=1, le=100000)
    ] = 50
    max_rate: Annotated[
        float, rule("Maximum turn rate of a vehicle that stands still.", "deg/s", gt=0, le=360)
    ] = 2.0
    max_speed: Annotated[
        float, rule("Maximum speed of a vehicle that stands still.", "m/s", gt=0, le=10)
    ] = 0.05
    max_spread: Annotated[
        float,
        rule(
            "Maximum spread of the accelerations of a vehicle that stands still.",
            "m/s2",
            gt=0,
            le=10,
        ),
    ] = 0.3
    parent_frame: Annotated[
        str, rule("Name of the level frame.", "a name", pattern=f"^{NAME_PATTERN}$")
    ] = "world_init"
    child_frame: Annotated[
        str, rule("Name of the odometry's origin.", "a name", pattern=f"^{NAME_PATTERN}$")
    ] = "camera_init"
