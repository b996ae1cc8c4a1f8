"""The command line of `mapperd`, checked before anything is opened."""

import argparse
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mapperd import __version__
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.odometry.odometry_files import OdometryOptions
from oculus_driver.command_line import CommandParser, did_you_mean

__all__ = ["Arguments", "parse_arguments"]

MAX_POSITION_M = 1e7
MAX_OFFSET_S = 1e10
EPILOG = """\
set up:
  mapperd init                  ask for the vehicle and the sonar, and write the settings
  mapperd doctor                check every link, and name a remedy for the first failure
  mapperd calibrate RECORDING   estimate mounting angles, time offset and scale of the ranges

map live:
  mapperd                       with the settings of `mapperd init`
  mapperd --config vehicle.yaml --duration 600 --out dive

map recordings:
  mapperd --replay dive.mcap --out dive
  mapperd --replay dive.mcap --view
  mapperd --replay recordings/ --as-recorded

exit codes: 0 the map is written; 2 usage error; 65 not a recording, nothing was mapped, or a part
is damaged; 66 cannot open the recording; 69 cannot open a link; 73 cannot write; 78 invalid
settings; 130 interrupted"""


@dataclass(frozen=True, slots=True)
class Arguments:
    """The parsed command line.

    Attributes:
        replay: the recordings, in order, or folders of them; none maps live.
        as_recorded: repeat the live session with all recorded decisions.
        config: the settings file on top of the machine's and the user's, None for those alone.
        out: folder of the results.
        store: file of the map, to resume from; None keeps the map in memory.
        pose: pose of the base in the map for every ping; None uses the odometry.
        integrator: overrides the setting; None keeps it.
        start_s, duration_s: the part of the recording to map.
        allow_damaged: map data that fail their checksum, too.
        odometry: files that replace the recorded odometry; None uses that.
        view_port: port of the page that shows the replay; None shows none.
        refine: integrate all echoes once more at the end.
        align: estimate the trajectory again before mapping.
        fixes: file of known positions for it.
    """

    replay: tuple[Path, ...]
    as_recorded: bool
    config: Path | None
    out: Path
    store: Path | None
    pose: Pose | None
    integrator: str | None
    start_s: float
    duration_s: float | None
    allow_damaged: bool = False
    view_port: int | None = None
    odometry: OdometryOptions | None = None
    refine: bool = False
    align: bool = False
    fixes: Path | None = None


VIEW_PORT = 8080

MAP_SUFFIXES = (".map", ".bt", ".ot")

COMMANDS = ("calibrate", "doctor", "init")
"""The first word of other command lines."""


def parse_arguments(
    argv: Sequence[str], commands: Sequence[Callable[[], CommandParser]] = ()
) -> Arguments:
    """Read the command line.

    Args:
        argv: its words.
        commands: make the parsers of the commands, which the completion of a shell names, too.

    Raises:
        SystemExit: with code 2 and one line on stderr; with 0 after --help and --version.
    """
    parser = _parser(commands)
    args, rest = parser.parse_known_args(_with_joined_pose(argv))
    if rest:
        parser.error(_unknown(rest))
    if not args.replay and args.start:
        parser.error("--start needs --replay")
    if args.view is not None and not args.replay:
        parser.error("--view needs --replay; for a running daemon: mapperctl view")
    if args.view is not None and args.store is not None:
        parser.error("--view cannot be combined with --store; mapperctl view MAP follows the file")
    if args.store is not None and (not args.replay or args.start or args.duration):
        parser.error("--store needs --replay, without --start and --duration")
    if args.allow_damaged and not args.replay:
        parser.error("--allow-damaged needs --replay")
    if problem := _bad_pass(args) or _bad_odometry(args):
        parser.error(problem)
    if args.as_recorded and (problem := _contradiction(args)) is not None:
        parser.error(problem)
    return Arguments(
        replay=tuple(args.replay),
        as_recorded=args.as_recorded,
        config=args.config,
        out=args.out or Path("mapperd-replay" if args.replay else "mapperd-live"),
        store=args.store,
        pose=args.pose,
        integrator=args.integrator,
        start_s=args.start,
        duration_s=args.duration,
        allow_damaged=args.allow_damaged,
        view_port=args.view,
        odometry=_odometry(args),
        refine=args.refine,
        align=args.align,
        fixes=args.fixes,
    )


def _unknown(words: Sequence[str]) -> str:
    """Return what to do about words that mapperd does not take."""
    stray = next((word for word in words if not word.startswith("-")), None)
    if stray is None or words[0] != stray:
        return f"unrecognized arguments: {' '.join(words)}"
    if not Path(stray).exists() and (hint := did_you_mean(stray, COMMANDS)):
        return f"there is no command {stray!r}{hint}"
    quoted, suffix = shlex.quote(stray), Path(stray).suffix
    if suffix in (".yaml", ".yml"):
        return f"{stray}: to map with these settings: mapperd --config {quoted}"
    if suffix in MAP_SUFFIXES:
        return f"{stray}: to show a map: mapperctl view {quoted}"
    return f"{stray}: to map a recording: mapperd --replay {quoted}"


def _odometry(args: argparse.Namespace) -> OdometryOptions | None:
    if not args.odometry:
        return None
    frames = None if args.odometry_frames is None else tuple(args.odometry_frames)
    return OdometryOptions(tuple(args.odometry), args.odometry_offset, args.odometry_topic, frames)


def _bad_pass(args: argparse.Namespace) -> str | None:
    """Return what contradicts that a recording is read more than once."""
    if args.refine and (not args.replay or args.store is not None):
        return "--refine needs --replay, without --store"
    if args.align and (not args.replay or args.store is not None or args.pose is not None):
        return "--align needs --replay, without --store and --pose"
    if args.fixes is not None and not args.align:
        return "--fixes needs --align"
    return None


def _bad_odometry(args: argparse.Namespace) -> str | None:
    """Return what the options of the odometry's files contradict."""
    if args.odometry and not args.replay:
        return "--odometry needs --replay"
    if args.odometry and args.pose is not None:
        return "--odometry cannot be combined with --pose"
    for name in ("offset", "topic", "frames"):
        if getattr(args, f"odometry_{name}") and not args.odometry:
            return f"--odometry-{name} needs --odometry"
    return None


def _contradiction(args: argparse.Namespace) -> str | None:
    """Return which option contradicts --as-recorded, which takes all from the recording."""
    if not args.replay:
        return "--as-recorded needs --replay"
    others = ("config", "store", "pose", "odometry", "integrator", "start", "duration", "align")
    found = [f"--{name}" for name in others if getattr(args, name)]
    return f"--as-recorded cannot be combined with {', '.join(found)}" if found else None


def _parser(commands: Sequence[Callable[[], CommandParser]] = ()) -> CommandParser:
    parser = CommandParser(
        prog="mapperd",
        description="Map the pings of an Oculus sonar in 3D, live or from recordings.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    replay = parser.add_argument_group("map recordings").add_argument
    add = parser.add_argument_group("map live or recordings").add_argument
    replay(
        "--replay",
        metavar="FILE",
        type=Path,
        nargs="+",
        default=[],
        help="recordings in order, or folders of them; default: map live",
    )
    replay(
        "--as-recorded",
        action="store_true",
        help="repeat the live session, with its settings, drops, resets and requests",
    )
    add(
        "--config",
        metavar="YAML",
        type=Path,
        help="settings file; overrides all others (docs/reference/configuration.md)",
    )
    add(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder for map.bt, map.ply, map.png and summary.json (default: mapperd-replay, or "
        "mapperd-live)",
    )
    replay(
        "--store",
        metavar="MAP",
        type=Path,
        help="keep the map in this file; resumes after an interruption",
    )
    add(
        "--pose",
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        type=_pose,
        help="pose of a vehicle that stands still (metres, degrees); ignores odometry",
    )
    replay(
        "--odometry",
        metavar="FILE",
        type=Path,
        nargs="+",
        default=[],
        help="odometry of other files in place of the recorded one: TUM, CSV with a header, ROS "
        "bags, ArduPilot .tlog and .BIN, captures, recordings",
    )
    replay(
        "--odometry-offset",
        metavar="S",
        type=_offset,
        default=0.0,
        help="add S seconds to the times of these files",
    )
    replay("--odometry-topic", metavar="TOPIC", help="topic of the poses in a ROS bag")
    replay(
        "--odometry-frames",
        metavar=("FIXED", "BODY"),
        nargs=2,
        help="frames of the poses in a ROS bag's transforms (default: odom or map, base_link)",
    )
    add(
        "--integrator",
        choices=("evidence_grid", "rays"),
        help="method of integration (default: the setting mapping.integrator)",
    )
    replay(
        "--start",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="skip the first S seconds",
    )
    replay(
        "--refine",
        action="store_true",
        help="then map all echoes again, the last ping first, by what the other pings have found "
        "(needs mapping.rule: arc); keeps the map in memory",
    )
    replay(
        "--align",
        action="store_true",
        help="first estimate the drifting trajectory again from what the sonar saw, and map with "
        "it if that is better (docs/guides/align.md); writes DIR/alignment/",
    )
    replay(
        "--fixes",
        metavar="FILE",
        type=Path,
        help="with --align: positions that are known, such as by GPS at the surface: CSV with "
        "time_s,x_m,y_m,deviation_m or time_s,latitude_deg,longitude_deg,deviation_m",
    )
    replay(
        "--view",
        metavar="PORT",
        nargs="?",
        type=int,
        const=VIEW_PORT,
        help="show the replay in the browser, until Ctrl-C; keeps the map in memory (default "
        f"port: {VIEW_PORT})",
    )
    add("--duration", metavar="S", type=_positive, help="map S seconds and stop")
    replay(
        "--allow-damaged",
        action="store_true",
        help="also map recorded data that fail their checksum",
    )
    parser.add_argument("--version", action="version", version=f"mapperd {__version__}")
    parser.add_completion(lambda: _with_commands(commands))
    return parser


def _with_commands(commands: Sequence[Callable[[], CommandParser]]) -> CommandParser:
    """Return the command line with its commands, for completion."""
    parser = _parser()
    added = parser.add_subparsers(metavar="COMMAND")
    for one in (make() for make in commands):
        name = one.prog.split()[-1]
        added.add_parser(name, help=one.description, parents=[one], conflict_handler="resolve")
    return parser


def _with_joined_pose(argv: Sequence[str]) -> list[str]:
    """Argparse takes "-1,0,..." for an option; joined to its own option it is a value."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] in ("--pose", "--odometry-offset"):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _pose(text: str) -> Pose:
    try:
        x, y, z, roll, pitch, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: six numbers x,y,z,roll,pitch,yaw were expected (metres, degrees)"
        ) from None
    if not all(math.isfinite(number) for number in (x, y, z, roll, pitch, yaw)):
        raise argparse.ArgumentTypeError(f"{text!r}: every number must be finite")
    if max(abs(x), abs(y), abs(z)) > MAX_POSITION_M:
        raise argparse.ArgumentTypeError(f"{text!r}: farther than {MAX_POSITION_M:g} m away")
    return pose_from_rpy((x, y, z), (roll, pitch, yaw))


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < MAX_POSITION_M:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds >= 0 was expected")
    return value


def _offset(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_OFFSET_S:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds was expected")
    return value


def _positive(text: str) -> float:
    value = _seconds(text)
    if value == 0:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds > 0 was expected")
    return value
