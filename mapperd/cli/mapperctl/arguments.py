"""The command line of `mapperctl`."""

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from mapperd import __version__
from mapperd.api import STD_XY_M, STD_YAW_RAD
from mapperd.cli.mapperctl.connection import CtlError
from mapperd.cli.mapperctl.sonar import add_sonar
from mapperd.config.catalog import parameters
from mapperd.config.daemon import NO_OR_TOPIC_PATTERN
from mapperd.config.loader import YamlProblem, parse_yaml
from mapperd.config.odometry import parse_address
from mapperd.errors import ConfigError
from mapperd.wire.messages import MAX_LEVEL, WANTS
from oculus_driver.command_line import CommandParser, ExitCode, GroupedHelp, did_you_mean

__all__ = [
    "add_bag",
    "add_changes",
    "add_convert",
    "add_diff",
    "add_export",
    "add_foxglove",
    "add_localization",
    "add_mavlink",
    "add_record",
    "add_ros2",
    "add_view",
    "parser",
    "pose_from_args",
]

SIX = 6
MAX, MAX_M, MAX_S, MAX_DEG = 1e6, 1e6, 1e9, 3600.0
HELP_FORMATS = "the suffix selects the format (docs/guides/export.md)"


def add_convert(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `convert`."""
    command.add_argument(
        "source", metavar="SOURCE", type=Path, help="a daemon's map, .map, .bt, .ot"
    )
    command.add_argument("file", metavar="FILE", type=Path, help=HELP_FORMATS)
    _add_origin(command)
    _add_probability(command)
    _add_calibration(command)
    _add_damaged(command)


def add_diff(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `diff`."""
    add = command.add_argument
    kinds = "a daemon's map, .map, .bt, .ot"
    add("first", metavar="A", type=Path, help=f"the earlier map: {kinds}")
    add("second", metavar="B", type=Path, help="the later map, likewise")
    add(
        "--tolerance",
        metavar="M",
        type=_metres,
        help="voxels within this distance are the same; default: two of the coarser map",
    )
    add("--out", metavar="FILE", type=Path, help="write a coloured cloud, .ply")
    add(
        "--min-voxels",
        metavar="N",
        type=_positive_count,
        help="list changes of at least so many voxels; default: changes.min_voxels",
    )
    add("--json", action="store_true", help="print one JSON object")
    _add_probability(command)
    _add_damaged(command)


def add_export(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `export`."""
    add = command.add_argument
    add("file", metavar="FILE", type=Path, help=f"{HELP_FORMATS}; .mcap too")
    add(
        "--level",
        type=int,
        choices=range(MAX_LEVEL + 1),
        default=0,
        help="cells are cubes of 2**level voxels; default: 0",
    )
    add(
        "--box",
        metavar="X,Y,Z,X,Y,Z",
        type=_box,
        help="only inside these two corners, metres in the map",
    )
    add(
        "--radius",
        metavar="M",
        type=_metres,
        default=0.0,
        help="only within this radius of the vehicle; default: no limit",
    )
    add(
        "--timeout",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="fail if the map is not complete by then; default: never",
    )
    _add_origin(command)
    _add_probability(command)
    _add_calibration(command)
    _add_damaged(command)


def add_bag(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `bag`."""
    add = command.add_argument
    add("source", metavar="SOURCE", type=Path, help="a recording, a folder of them, or a map")
    add("bag", metavar="BAG", type=Path, help="folder to create")
    add("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default: mcap")
    add(
        "--as-recorded", action="store_true", help="map recordings with their own settings, as live"
    )
    add(
        "--pose",
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        type=_pose,
        help="pose of a vehicle that did not move",
    )
    add(
        "--every",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="period of the map's cloud; default: only at the end",
    )
    _add_probability(command)
    _add_damaged(command)


def _add_origin(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--origin",
        metavar="LAT,LON",
        type=_origin,
        help="geographic position of the map's origin, in degrees; default: that of the map, or "
        "odometry.origin",
    )


def _add_probability(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--min-probability",
        metavar="P",
        type=_probability,
        help="minimum probability of occupied voxels; default: the rule's occupied_threshold",
    )


def _add_damaged(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--allow-damaged",
        action="store_true",
        help="write what is left of a map with damaged bricks, which is refused otherwise",
    )


def _add_calibration(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="calibration curve of the probabilities, such as config/calibration/harbour.yaml; "
        "default: none",
    )


def _origin(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) < 90 and abs(longitude) <= 180):  # noqa: PLR2004 degrees
        raise argparse.ArgumentTypeError(f"{text!r}: latitude,longitude in degrees were expected")
    return latitude, longitude


def _pose(text: str) -> tuple[float, ...]:
    """Parse metres and degrees."""
    return _six(text, "x,y,z,roll,pitch,yaw")


def _box(text: str) -> tuple[float, ...]:
    values = _six(text, "x,y,z,x,y,z")
    low, high = values[:3], values[3:]
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise argparse.ArgumentTypeError(f"{text!r}: the lower corner comes first")
    return values


def _six(text: str, names: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != SIX or not all(abs(value) <= MAX for value in values):
        raise argparse.ArgumentTypeError(f"{text!r}: {names} were expected")
    return values


def _positive_count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 0 < int(text[:16]) <= MAX):
        raise argparse.ArgumentTypeError(f"{text!r}: a number of voxels was expected")
    return int(text)


def _metres(text: str) -> float:
    return _number(text, 0.0, MAX_M, "metres")


def _seconds(text: str) -> float:
    return _number(text, 0.0, MAX, "seconds")


def _number(text: str, minimum: float, maximum: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not minimum <= value <= maximum:
        raise argparse.ArgumentTypeError(
            f"{text!r}: {minimum:g} to {maximum:g} {unit} were expected"
        )
    return value


def _probability(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a probability between 0 and 1 was expected")
    return value


def add_foxglove(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `foxglove`."""
    add = command.add_argument
    add("--port", metavar="N", type=_port, default=8765, help="default: 8765")
    add(
        "--host",
        metavar="NAME",
        default="127.0.0.1",
        help="address to listen on; default: 127.0.0.1, only this computer",
    )
    add(
        "--viewer-token-file",
        metavar="FILE",
        type=Path,
        help="token of viewers, as ?token=TOKEN in the address; other computers need one",
    )
    add(
        "--allow-origin",
        metavar="ORIGIN",
        type=_page_origin,
        action="append",
        default=[],
        help="also admit pages of this origin, such as http://localhost:8080",
    )
    add("--allow-changes", action="store_true", help="viewers may change settings")
    _add_interest(command)


def add_mavlink(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `mavlink`."""
    command.add_argument(
        "--to",
        metavar="LINK",
        type=_datagram_link,
        help="where the autopilot listens, udp://HOST:PORT; default: mavlink.address",
    )


def add_changes(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `changes`."""
    add = command.add_argument
    add(
        "known",
        metavar="KNOWN",
        type=Path,
        help="the known map, of the same frame: a daemon's map, .map, .bt, .ot",
    )
    _add_radius(command)
    _add_damaged(command)


def add_ros2(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `ros2`."""
    add = command.add_argument
    add(
        "--domain",
        metavar="N",
        type=_domain,
        help="DDS domain; default: ros2.domain, else ROS_DOMAIN_ID, else 0",
    )
    add(
        "--namespace",
        metavar="NAME",
        type=_ros_namespace,
        help="of topics and services; default: ros2.namespace",
    )
    _add_interest(command)


def add_record(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `record`."""
    add = command.add_argument
    add(
        "file",
        metavar="FILE",
        type=Path,
        help=".mcap: everything that is received; another suffix: the map at the end",
    )
    add("--duration", metavar="S", type=_duration, help="default: until interrupted")
    add(
        "--wants",
        metavar="KIND,...",
        type=_wants,
        default=WANTS,
        help=f"what to record, of {', '.join(WANTS)}; default: all",
    )
    _add_interest(command)


def _add_interest(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add(
        "--level",
        metavar="N",
        type=int,
        choices=range(MAX_LEVEL + 1),
        default=0,
        help=f"cells of 2**N voxels along an edge, 0 to {MAX_LEVEL}: less data",
    )
    _add_radius(command)


def _add_radius(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--radius",
        metavar="M",
        type=_metres,
        default=0.0,
        help="only the map within this radius of the vehicle",
    )


def _wants(text: str) -> tuple[str, ...]:
    wants = tuple(filter(None, text.split(",")))
    if not wants or (strange := set(wants) - set(WANTS)):
        what = ", ".join(sorted(strange)) if wants else "nothing"
        raise argparse.ArgumentTypeError(f"{what}: some of {', '.join(WANTS)} were expected")
    return wants


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) < 1 << 16):
        raise argparse.ArgumentTypeError(f"{text!r}: a port was expected")
    return int(text)


def _datagram_link(text: str) -> str:
    try:
        is_udp = parse_address(text).kind == "udp"
    except ValueError:
        is_udp = False
    if not is_udp:
        raise argparse.ArgumentTypeError(f"{text!r}: udp://HOST:PORT was expected")
    return text


def _domain(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text[:9]) <= 232):  # noqa: PLR2004 of DDS
        raise argparse.ArgumentTypeError(f"{text!r}: a domain from 0 to 232 was expected")
    return int(text)


def _ros_namespace(text: str) -> str:
    if not re.fullmatch(NO_OR_TOPIC_PATTERN, text):
        raise argparse.ArgumentTypeError(f"{text!r}: a namespace was expected, such as rov1")
    return text


def _page_origin(text: str) -> str:
    scheme, mark, host = text.lower().rstrip("/").partition("://")
    if not (scheme and mark and host) or "/" in host:
        raise argparse.ArgumentTypeError(f"{text!r}: an origin was expected: http://HOST:PORT")
    return f"{scheme}://{host}"


def _duration(text: str) -> float:
    return _number(text, 0.001, MAX_S, "seconds")


Add = Callable[..., argparse.ArgumentParser]


def add_localization(add: Add) -> None:
    """Add the commands.

    Args:
        add: creates a command from its name, summary and description.
    """
    look = add("localization", "where the vehicle is on the known map")
    look.add_argument("--watch", action="store_true", help="repeat until interrupted")
    look.add_argument(
        "--particles",
        metavar="N",
        type=_particles,
        default=0,
        help="with --json: number of particles to print",
    )
    look.set_defaults(every=1.0)
    _add_pose(add("initial_pose", "start localization at a pose"))
    add("global_localization", "start localization anywhere on the map")
    add("request_nomotion_update", "update the filter with the next scan even without motion")
    change = add("set_map", "switch to another map, and to a pose if one is given")
    change.add_argument("name", metavar="FILE", help="file in the daemon's maps folder")
    _add_pose(change, nargs="?")


def pose_from_args(args: argparse.Namespace) -> dict[str, Any] | None:
    """Return the pose on the command line as the daemon expects it, or None without one.

    Raises:
        CtlError: the pose is incomplete.
    """
    if args.yaw_deg is None:
        if any(part is not None for part in (args.x, args.std_xy, args.std_yaw_deg)):
            raise CtlError("a pose is X Y YAW_DEG", ExitCode.USAGE)
        return None
    pose = {"x_m": args.x, "y_m": args.y, "yaw_rad": math.radians(args.yaw_deg)}
    if args.frame:
        pose["frame"] = args.frame
    if args.covariance:
        xx, xy, xa, yy, ya, aa = args.covariance
        return pose | {"covariance": [[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]]}
    if args.std_xy is not None:
        pose["std_xy_m"] = args.std_xy
    if args.std_yaw_deg is not None:
        pose["std_yaw_rad"] = math.radians(args.std_yaw_deg)
    return pose


def _add_pose(command: argparse.ArgumentParser, nargs: Literal["?"] | None = None) -> None:
    add = command.add_argument
    add("x", metavar="X", type=_coordinate, help="x in the map frame, m", nargs=nargs)
    add("y", metavar="Y", type=_coordinate, help="y in the map frame, m", nargs=nargs)
    about = "heading, counter-clockwise from x"
    add("yaw_deg", metavar="YAW_DEG", type=_degrees, help=about, nargs=nargs)
    add(
        "--std-xy",
        metavar="M",
        type=_metres,
        help=f"standard deviation of x and y; default: {STD_XY_M:g} m",
    )
    default_deg = math.degrees(STD_YAW_RAD)
    add(
        "--std-yaw-deg",
        metavar="DEG",
        type=_deviation_deg,
        help=f"that of the heading; default: {default_deg:g} deg",
    )
    add(
        "--covariance",
        metavar="XX,XY,XA,YY,YA,AA",
        type=_covariance,
        help="covariance in place of the standard deviations, in m2, m rad and rad2",
    )
    add(
        "--frame",
        metavar="NAME",
        default="",
        help="frame of the pose; default: amcl.global_frame_id",
    )


def _coordinate(text: str) -> float:
    return _number(text, -MAX_M, MAX_M, "m")


def _degrees(text: str) -> float:
    return _number(text, -MAX_DEG, MAX_DEG, "degrees")


def _deviation_deg(text: str) -> float:
    return _number(text, 0.0, MAX_DEG, "degrees")


def _covariance(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != SIX or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text!r}: six numbers with commas were expected")
    return values


def _particles(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text[:9]) <= 500):  # noqa: PLR2004 written in the message
        raise argparse.ArgumentTypeError(f"{text!r}: 0 to 500 particles were expected")
    return int(text)


def add_view(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `view`."""
    add = command.add_argument
    add(
        "file",
        metavar="FILE",
        nargs="?",
        type=Path,
        help="show this map file instead of a daemon: a daemon's map, .map, .bt, .ot",
    )
    add("--port", metavar="N", type=_port, default=8080, help="port of the page; default: 8080")
    add(
        "--host",
        metavar="NAME",
        default="127.0.0.1",
        help="address of the page; default: 127.0.0.1, only this computer",
    )
    add(
        "--allow-changes",
        action="store_true",
        help="browsers on other computers may change settings",
    )
    _add_interest(command)
    add("--open", action="store_true", help="open the page in a browser")


EXIT_CODES = """\
exit codes: 0 success; 1 refused by the daemon; 2 usage error; 65 not a map,
or a damaged one; 66 no such file; 69 no daemon answers; 73 cannot write;
75 try again later; 76 protocol mismatch; 77 permission denied; 78 invalid
settings, or a missing extra; 130 interrupted"""

EPILOG = f"""examples:
  mapperctl status --watch
  mapperctl set filtering.min_range=1.5 --persist
  mapperctl export harbour.ply
  mapperctl view dive/map.bt --open
  mapperctl diff before.map after.map

{EXIT_CODES}"""

GROUPS = MappingProxyType(
    {
        "observe": (
            "status",
            "view",
            "events",
            "foxglove",
            "mavlink",
            "ros2",
            "changes",
        ),
        "settings": ("params", "get", "set", "reload", "sonar"),
        "map": ("save", "export", "record", "snapshot", "reset"),
        "localization": (
            "localization",
            "initial_pose",
            "global_localization",
            "request_nomotion_update",
            "set_map",
        ),
        "files, without a daemon": ("convert", "diff", "bag"),
    }
)
"""Commands by what they are for, in the order of the help."""


def parser() -> CommandParser:
    """Return the parser of all commands."""
    top = CommandParser(
        "mapperctl",
        description="Observe and control a running mapperd; look at maps and convert them.",
        epilog=EPILOG,
        formatter_class=GroupedHelp,
    )
    top.groups = GROUPS
    top.add_completion()
    commands = top.add_subparsers(metavar="COMMAND", required=True, dest="command")
    status = _command(commands, "status", "print the state of the daemon")
    status.add_argument("--watch", action="store_true", help="repeat until interrupted")
    status.add_argument("--once", action="store_true", help="with --json: print one object")
    status.add_argument(
        "--every", metavar="S", type=_period, help="repeat at this period; default: 1 s"
    )
    _params(commands)
    get = _command(commands, "get", "print settings in force")
    get.add_argument("names", metavar="NAME", nargs="+", type=_name, help="a setting or a section")
    change = _command(commands, "set", "change settings of the running daemon, all or none")
    change.add_argument("changes", metavar="NAME=VALUE", nargs="+", type=_change)
    change.add_argument(
        "--persist",
        metavar="FILE",
        nargs="?",
        type=Path,
        const=Path(),
        help="write the values into the settings files too; FILE: into this one",
    )
    about = "show and change the settings of the sonar, while it maps"
    add_sonar(_command(commands, "sonar", about))
    save = _command(commands, "save", "write the map into the daemon's maps folder")
    save.add_argument(
        "name", metavar="FILE", help="name without a folder; the suffix selects the format"
    )
    reset = _command(commands, "reset", "empty the map")
    reset.add_argument("--yes", action="store_true", help="do not ask")
    _command(commands, "reload", "reload the settings files")
    _command(commands, "snapshot", "flush the map and the recording to disk")
    add_view(_command(commands, "view", "show the live map, or a map file, in the browser"))
    about = "serve Foxglove and Lichtblick"
    add_foxglove(_command(commands, "foxglove", about, "Serve Foxglove and Lichtblick."))
    about = "send poses and obstacles to an autopilot"
    add_mavlink(_command(commands, "mavlink", about))
    about = "report what appears and vanishes against a known map"
    add_changes(_command(commands, "changes", about))
    about = "publish to ROS 2 over DDS, without ROS"
    add_ros2(_command(commands, "ros2", about))
    add_record(_command(commands, "record", "record the map stream"))
    add_export(_command(commands, "export", "save the live map as a file on this computer"))
    add_convert(_offline(commands, "convert", "convert a map file to another format"))
    about = "compare two maps both ways"
    add_diff(_offline(commands, "diff", about))
    add_bag(_offline(commands, "bag", "convert a recording or a map to a ROS 2 bag, without ROS"))
    add_localization(lambda *args: _command(commands, *args))
    events = _command(commands, "events", "print events")
    events.add_argument("--follow", action="store_true", help="print new events until interrupted")
    events.add_argument(
        "--since", metavar="N", type=_count, default=0, help="only events after this number"
    )
    top.add_version(f"mapperctl {__version__}")
    return top


def _params(commands: "argparse._SubParsersAction[CommandParser]") -> None:
    params = _command(
        commands,
        "params",
        "print settings with their descriptions",
        "Print the settings of the configuration files; with --running, --socket or --address, the "
        "settings in force in the running daemon.",
    )
    add = params.add_argument
    add("names", metavar="NAME", nargs="*", type=_name, help="a setting or a section of them")
    add("--origin", action="store_true", help="also print where each value comes from")
    add("--running", action="store_true", help="settings of the running daemon")


def _command(
    commands: "argparse._SubParsersAction[CommandParser]",
    name: str,
    about: str,
    more: str | None = None,
) -> CommandParser:
    command = _offline(commands, name, about, more)
    add = command.add_argument
    add("--json", action="store_true", help="print JSON, one object a line")
    add("--socket", metavar="PATH", type=Path, help="Unix socket of the daemon")
    add("--address", metavar="HOST:PORT", help="TCP address of the daemon instead")
    add(
        "--token-file",
        metavar="FILE",
        type=Path,
        help="token for --address (default: server.token_file, else `token` beside the user's "
        "settings)",
    )
    add("--tls-ca", metavar="PEM", type=Path, help="use TLS and trust these certificates")
    return command


def _offline(
    commands: "argparse._SubParsersAction[CommandParser]",
    name: str,
    about: str,
    more: str | None = None,
) -> CommandParser:
    """A command that needs no daemon."""
    command = commands.add_parser(
        name, help=about, description=more or f"{about.capitalize()}.", epilog=EXIT_CODES
    )
    command.add_argument(
        "--config",
        metavar="YAML",
        type=Path,
        action="append",
        default=[],
        help="settings file of mapperd; repeat to layer files, the last one wins",
    )
    return command


def _name(text: str) -> str:
    if not any(name == text or name.startswith(f"{text}.") for name in parameters()):
        sections = dict.fromkeys(name.rpartition(".")[0] for name in parameters())
        near = did_you_mean(text, [*parameters(), *sections])
        raise argparse.ArgumentTypeError(f"{text!r}: there is no such setting{near}")
    return text


def _change(text: str) -> tuple[str, object]:
    name, sign, value = text.partition("=")
    if not sign:
        raise argparse.ArgumentTypeError(f"{text!r}: NAME=VALUE was expected")
    try:
        return _name(name), parse_yaml(value)
    except (YamlProblem, ConfigError) as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from None


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 16):  # noqa: PLR2004 within 2**53
        raise argparse.ArgumentTypeError(f"{text!r}: the number of an event was expected")
    return int(text)


def _period(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 3600:  # noqa: PLR2004 written in the message
        raise argparse.ArgumentTypeError(f"{text!r}: 0.1 to 3600 seconds were expected")
    return value
