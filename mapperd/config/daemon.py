"""Settings of the daemon and of the bridges: service, map on disk, exports, names, outputs.

The sections `frames` and `visualization` come from a ROS node. Here they name frames in telemetry
and bags, and pace the saves of the map.
"""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule
from mapperd.config.odometry import parse_address

__all__ = [
    "NO_OR_TOPIC_PATTERN",
    "BacklogConfig",
    "ChangesConfig",
    "ExportConfig",
    "FramesConfig",
    "MavlinkConfig",
    "MqttConfig",
    "OutOfCoreConfig",
    "RecordingConfig",
    "Ros2Config",
    "ServerConfig",
    "ServiceConfig",
    "StreamConfig",
    "TopicsConfig",
    "VisualizationConfig",
]

NAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9_-]{0,63}"


class ServiceConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Folders of the daemon."""

    state_folder: Annotated[
        str,
        rule(
            "Folder of the maps and the store; default: systemd's or the user's.",
            "a path or nothing",
        ),
    ] = ""


class RecordingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that comes in while mapping live, on disk as it came."""

    enabled: Annotated[
        bool, rule("Record all input. Without it, a crash loses what is not in the map's file.")
    ] = True
    folder: Annotated[
        str,
        rule(
            "Folder of the recordings; default: systemd's log folder, or `recordings` in the "
            "state folder.",
            "a path or nothing",
        ),
    ] = ""
    max_file: Annotated[int, rule("Maximum size of one file.", "MiB", ge=1, le=1 << 20)] = 512
    budget: Annotated[
        int,
        rule(
            "Maximum size of all files; the oldest are deleted. 0: no limit.",
            "MiB",
            ge=0,
            le=1 << 30,
        ),
    ] = 32768
    free_floor: Annotated[int, rule("Minimum free disk space.", "MiB", ge=0, le=1 << 30)] = 1024
    require_space: Annotated[
        bool,
        rule(
            "Refuse to start a session while the disk has no space to record it or to keep its "
            "map. Without it, such a session is mapped in memory and saved at its end as far as "
            "space allows."
        ),
    ] = True
    allow_damaged: Annotated[
        bool,
        rule("Map recorded data that fail their checksum when a session is recovered or rebuilt."),
    ] = False


class BacklogConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """What happens when pings come faster than they can be mapped: the oldest are dropped."""

    max_wait: Annotated[
        float,
        rule(
            "A ping is dropped if newer ones wait and its last byte, or the odometry for its "
            "pose, arrived longer ago than this.",
            "s",
            gt=0,
            le=60,
        ),
    ] = 1.0


class ServerConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The socket and the TCP address that serve the live map and take requests."""

    socket: Annotated[
        str,
        rule(
            "Path of the Unix socket; default: `mapperd.sock` in systemd's or the user's "
            "runtime folder.",
            "an absolute path or nothing",
            pattern="^(/[^\\x00]*)?$",
        ),
    ] = ""
    mode: Annotated[
        str, rule("Permissions of the Unix socket.", "octal digits", pattern="^0?[0-7]{3}$")
    ] = "660"
    address: Annotated[
        str,
        rule(
            "TCP address to listen on, such as `127.0.0.1:7471`; addresses other than "
            "loopback need a token.",
            "host:port or nothing",
        ),
    ] = ""
    token_file: Annotated[
        str,
        rule(
            "File with the token for TCP; default: systemd's credential `server-token`. "
            "Without a token, TCP clients may read everything and change nothing.",
            "a path or nothing",
        ),
    ] = ""
    tls_certificate: Annotated[
        str, rule("Certificate chain in PEM; enables TLS.", "a path or nothing")
    ] = ""
    tls_key: Annotated[str, rule("Private key in PEM.", "a path or nothing")] = ""
    max_clients: Annotated[
        int, rule("Maximum number of clients that follow the map.", "clients", ge=1, le=1000)
    ] = 100


class StreamConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the live map is sent: docs/reference/map-stream.md."""

    rate: Annotated[
        float,
        rule("Rate at which changes of the map are sent.", "Hz", live=True, gt=0, le=20),
    ] = 5.0
    log_odds_step: Annotated[
        float, rule("Log-odds are sent in multiples of this value.", "log-odds", ge=0.01, le=5)
    ] = 0.25
    bytes_per_s: Annotated[
        int, rule("Maximum rate to one client; 0: no limit.", "bytes/s", ge=0, le=1 << 40)
    ] = 0
    path_points: Annotated[
        int,
        rule(
            "Maximum number of points of the vehicle's path; a longer path is thinned by two.",
            "points",
            ge=100,
            le=100_000,
        ),
    ] = 20_000


class MqttConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Telemetry to a broker."""

    host: Annotated[
        str, rule("Host of the broker; empty disables telemetry.", "a name or nothing")
    ] = ""
    port: Annotated[int, rule("Port of the broker.", ge=1, le=65535)] = 1883
    tls: Annotated[bool, rule("Encrypt, and check the broker's certificate.")] = False
    ca_file: Annotated[
        str, rule("Certificate authorities to trust instead of the system's.", "a path or nothing")
    ] = ""
    username: Annotated[str, rule("User name at the broker.", "a name or nothing")] = ""
    password_file: Annotated[
        str,
        rule(
            "File with the password; default: systemd's credential `mqtt-password`.",
            "a path or nothing",
        ),
    ] = ""
    prefix: Annotated[
        str, rule("First part of every topic.", "a topic", pattern="^[^#+\\x00]{1,100}$")
    ] = "mapperd/v1"
    vehicle: Annotated[
        str, rule("Second part of every topic.", "a name", pattern=f"^{NAME_PATTERN}$")
    ] = "vehicle"
    keepalive: Annotated[int, rule("Keep-alive period of the connection.", "s", ge=5, le=3600)] = 15
    queue: Annotated[
        int,
        rule("Maximum number of messages that wait for the broker.", "messages", ge=10, le=100000),
    ] = 1000
    pose_rate: Annotated[float, rule("Maximum rate of poses.", "Hz", live=True, gt=0, le=50)] = 5.0
    commands: Annotated[bool, rule("Accept commands from `cmd/...` and `config/.../set`.")] = False


class OutOfCoreConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Tiles in a file, of which only some are in memory."""

    use: Annotated[bool, rule("Keep the map on disk.")] = False
    map_path: Annotated[
        str,
        rule("Path of the map's file; default: in the state folder.", "a path or nothing"),
    ] = ""
    tile_size: Annotated[
        float, rule("Edge of a tile; at least eight voxels.", "m", ge=0.01, le=10000)
    ] = 10.0
    cache_size: Annotated[
        int, rule("Maximum number of tiles in memory.", "tiles", ge=1, le=1000000)
    ] = 16


class ExportConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Which heights the flat formats look at: `.asc`, `.tif` and `.pgm`."""

    min_z: Annotated[
        float, rule("Voxels whose centres lie lower are left out.", "m", live=True, ge=-1e5, le=1e5)
    ] = -1e5
    max_z: Annotated[
        float,
        rule("Voxels whose centres lie higher are left out.", "m", live=True, ge=-1e5, le=1e5),
    ] = 1e5

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.min_z >= self.max_z:
            raise ValueError(f"min_z {self.min_z:g} is not below max_z {self.max_z:g}")


FRAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9_/-]{0,63}"


class FramesConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """What telemetry, and bags of ROS 2, call the frames of reference."""

    sonar: Annotated[str, rule("Frame of the sonar.", "a name", pattern=f"^{FRAME_PATTERN}$")] = (
        "sonar_link"
    )
    base: Annotated[str, rule("Frame of the vehicle.", "a name", pattern=f"^{FRAME_PATTERN}$")] = (
        "base_link"
    )
    map: Annotated[str, rule("Frame of the map.", "a name", pattern=f"^{FRAME_PATTERN}$")] = "map"
    publish_tf: Annotated[
        bool, rule("Publish where the sonar sits on the vehicle, and again when that changes.")
    ] = True


class VisualizationConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How often the map is saved while mapping."""

    tile_save_interval: Annotated[
        float,
        rule("Interval between saves of the map on disk.", "s", live=True, gt=0, le=3600),
    ] = 5.0


TOPIC_PATTERN = "^/?[A-Za-z_][A-Za-z0-9_]{0,63}(/[A-Za-z_][A-Za-z0-9_]{0,63}){0,15}$"
REMAP_PATTERN = f"^({TOPIC_PATTERN[1:-1]}:={TOPIC_PATTERN[1:-1]}( (?=.)|$))*$"
NO_OR_TOPIC_PATTERN = TOPIC_PATTERN.replace("^", "^(", 1)[:-1] + ")?$"


class TopicsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Names of topics of `mapperctl ros2`; one without a leading / lies in `ros2.namespace`."""

    sonar: Annotated[
        str, rule("Image of each ping, published.", "a topic", pattern=TOPIC_PATTERN)
    ] = "/sensor/sonar/oculus/m750d/image"
    odometry: Annotated[
        str,
        rule(
            "Odometry of others, subscribed and passed to `ros2.odometry_link`.",
            "a topic",
            pattern=TOPIC_PATTERN,
        ),
    ] = "/fast_lio/odometry"
    pointcloud: Annotated[
        str, rule("Occupied voxels, published.", "a topic", pattern=TOPIC_PATTERN)
    ] = "/sonar_3d_map"
    marker: Annotated[
        str,
        rule(
            "Markers of other robots and of changes of the map, published.",
            "a topic",
            pattern=TOPIC_PATTERN,
        ),
    ] = "/sonar_3d_map_markers"


class Ros2Config(Struct, frozen=True, forbid_unknown_fields=True):
    """The bridge `mapperctl ros2`; the daemon itself speaks no ROS."""

    domain: Annotated[
        int, rule("DDS domain, as ROS_DOMAIN_ID; -1 takes that variable, else 0.", ge=-1, le=232)
    ] = -1
    namespace: Annotated[
        str,
        rule(
            "Namespace of relative topics and services, such as that of the robot.",
            "a name or nothing",
            pattern=NO_OR_TOPIC_PATTERN,
        ),
    ] = ""
    remap: Annotated[
        str,
        rule(
            "Other names of topics and services, as in ROS: /tf:=tf /map:=map. Relative names are "
            "in the namespace.",
            "rules FROM:=TO with a space between them, or nothing",
            pattern=REMAP_PATTERN,
        ),
    ] = ""
    cloud_period: Annotated[
        float, rule("Shortest time between two clouds or grids.", "s", ge=0.1, le=3600)
    ] = 2.0
    slice_height: Annotated[
        float,
        rule(
            "Thickness of the horizontal slice around the vehicle that the grid shows; 0 shows "
            "export.min_z to export.max_z.",
            "m",
            ge=0,
            le=1000,
        ),
    ] = 0.0
    odometry_link: Annotated[
        str,
        rule(
            "Where subscribed odometry goes: the link of a source of format native, such as "
            "udp://127.0.0.1:52200. Empty: odometry is not subscribed.",
            "a link or nothing",
            pattern="^(udp://.{1,300})?$",
        ),
    ] = ""
    commands: Annotated[bool, rule("Accept initial poses, services and changes of parameters.")] = (
        False
    )


class MavlinkConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The bridge `mapperctl mavlink` to an autopilot; off until it has an address."""

    address: Annotated[
        str,
        rule(
            "Where the autopilot, or its router, listens: udp://HOST:PORT.",
            "a link or nothing",
            pattern="^(udp://.{1,300})?$",
        ),
    ] = ""
    message: Annotated[
        Literal["vision", "odometry"],
        rule("Message of poses: VISION_POSITION_ESTIMATE, or ODOMETRY with the velocity."),
    ] = "vision"
    frame: Annotated[
        Literal["ned", "frd"],
        rule(
            "Axes of poses: ned if the map's x is east and y north; frd if the map is turned by "
            "an unknown heading, which gives its x as forward."
        ),
    ] = "ned"
    poses: Annotated[
        Literal["localization", "all"],
        rule(
            "localization: only poses by localization, while it is sure; all: those of the "
            "odometry too, if it is a SLAM of its own and not this autopilot's."
        ),
    ] = "localization"
    pose_rate: Annotated[float, rule("Maximum rate of poses; 0: none.", "Hz", ge=0, le=50)] = 10.0
    obstacle_rate: Annotated[
        float, rule("Maximum rate of OBSTACLE_DISTANCE; 0: none.", "Hz", ge=0, le=20)
    ] = 5.0
    obstacle_range: Annotated[
        float, rule("Obstacles farther away are not reported.", "m", ge=1, le=100)
    ] = 20.0
    obstacle_height: Annotated[
        float,
        rule(
            "Thickness of the horizontal slice around the vehicle that has obstacles.",
            "m",
            gt=0,
            le=100,
        ),
    ] = 1.0
    text_rate: Annotated[float, rule("Maximum rate of STATUSTEXT; 0: none.", "Hz", ge=0, le=10)] = (
        1.0
    )
    system_id: Annotated[int, rule("System of the vehicle, as SYSID_THISMAV.", ge=1, le=255)] = 1
    component_id: Annotated[int, rule("Component that messages come from.", ge=1, le=255)] = 197

    def __post_init__(self) -> None:
        """Check what no single field can.

        Raises:
            ValueError: the address has no host or port.
        """
        if self.address:
            parse_address(self.address)


class ChangesConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """What `mapperctl changes` reports of a live map against a known one."""

    period: Annotated[float, rule("Time between two reports.", "s", ge=0.5, le=3600)] = 5.0
    tolerance: Annotated[
        float,
        rule(
            "Voxels within this distance are the same: more than the height of the beam at the "
            "usual range, within which an echo may be anywhere. 0: two voxels.",
            "m",
            ge=0,
            le=100,
        ),
    ] = 1.0
    min_voxels: Annotated[
        int,
        rule("Changes of fewer voxels that touch are not reported.", "voxels", ge=1, le=1_000_000),
    ] = 20
