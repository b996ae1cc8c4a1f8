"""`mapperd init`: ask for the vehicle and the sonar, and write commented settings and a token."""

import argparse
import asyncio
import json
import math
import os
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from mapperd import __version__
from mapperd.cli.surroundings import listen, sonar_lines
from mapperd.config.layers import user_folder
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError
from mapperd.io import atomic_file
from mapperd.odometry.formats import check_libraries
from mapperd.server.listeners import address_of
from mapperd.wire.auth import is_loopback
from oculus_driver.command_line import CommandParser, ExitCode

__all__ = ["Setup", "init", "init_parser", "settings_text", "user_settings"]

VEHICLES = {
    "bluerov2": "BlueROV2 or another ArduSub vehicle, MAVLink from the autopilot",
    "native": "your own program sends native records over UDP",
    "nmea": "a boat or instrument sends NMEA over UDP",
}
DVLS = {
    "water-linked": "Water Linked A50 or A125, read directly",
    "autopilot": "the autopilot has its data already, such as from the BlueOS DVL extension",
    "none": "attitude and depth alone",
}


class WaterProperties(NamedTuple):
    """Salinity in ppt and density in kg/m3."""

    salinity: float
    density: float


WATERS = {"sea": WaterProperties(35.0, 1025.0), "fresh": WaterProperties(0.0, 998.0)}

NO_STREAM = "none"
SERVICE_SETTINGS = Path("/etc/mapperd/mapperd.yaml")
SERVICE_TOKEN = Path("/etc/credstore/mapperd.server-token")


@dataclass(frozen=True, slots=True)
class Setup:
    """A vehicle and its sonar; the defaults are a BlueROV2 with a Water Linked DVL.

    Attributes:
        vehicle: key of `VEHICLES`.
        dvl: key of `DVLS`; of a bluerov2 alone.
        dvl_address: of the DVL, where it is read directly.
        fixed: map with attitude and depth while the vehicle stays at one spot.
        sonar: its address, "" to discover it.
        position: of the sonar on the vehicle, m: forward, port, up.
        orientation: roll, pitch, yaw, degrees; pitch 0 looks ahead, 90 down.
        range_m: of the pings.
        water: key of `WATERS`.
        folder: of the map and the recordings, "" for the usual ones.
        stream: address of the map for other computers, "" for none.
        token: file that the settings name, None for none.
    """

    vehicle: str = "bluerov2"
    dvl: str = "water-linked"
    dvl_address: str = "192.168.2.95"
    fixed: bool = False
    sonar: str = ""
    position: tuple[float, float, float] = (0.2, 0.0, -0.15)
    orientation: tuple[float, float, float] = (0.0, 30.0, 0.0)
    range_m: float = 10.0
    water: str = "sea"
    folder: str = ""
    stream: str = "0.0.0.0:7471"
    token: Path | None = None


TEMPLATE = """\
# Settings of mapperd, as `mapperd init` writes them. `mapperctl params` explains all others.
mounting: # the sonar on the vehicle; measure it
  position: {{ x: {x}, y: {y}, z: {z} }} # m from the vehicle's origin: x forward, y to port, z up
  orientation: {{ roll: {roll}, pitch: {pitch}, yaw: {yaw} }} # deg; pitch 0 looks ahead, 90 down
device: # the sonar
  address: "{sonar}" # "" finds it by its broadcasts; this computer needs an address in its network
  range: {range_m} # m
water:
  salinity: {salinity} # ppt: 35 in the sea, 0 in fresh water; it sets the speed of sound
octree:
  voxel_resolution: 0.1 # m
outofcore:
  use: true # the map stays on disk and the next start continues it; `mapperctl reset` empties it
  map_path: {map_path} # "" is mapperd.map in the state folder, the user's or the service's
recording:
  folder: {recordings} # "" is in the state folder; the service's is /var/log/mapperd
odometry:
  sources:
{sources}{owners}{server}"""

AUTOPILOT = """\
    # In BlueOS, add a MAVLink endpoint "UDP client": this computer's address, port 52210. mapperd
    # only listens.
    - name: autopilot
      format: mavlink # needs the extra `mavlink`
      link: udp://0.0.0.0:52210
      water_density: {density} # kg/m3: 1025 in the sea, 998 in fresh water; for the depth
"""
DVL = """\
    # Remove it if BlueOS's DVL extension feeds the autopilot: its data would count twice.
    - name: dvl
      format: water_linked_json
      link: tcp://{dvl_address}:16171
"""
NATIVE = """\
    - name: vehicle # one native record in each datagram
      link: udp://0.0.0.0:52200
"""
NMEA = """\
    - name: vehicle
      format: nmea # needs the extra `nmea`
      link: udp://0.0.0.0:52200
"""
OWNERS = """\
  owners: # one source for each quantity; "" takes the first that has it
    position: {position}
    attitude: {attitude}
    depth: {depth}
    velocity: {velocity}
"""
ANY = '""'
FIXED = "fixed # the vehicle stays at one spot: x and y are 0, attitude and depth are measured"
MAYBE_FIXED = """\
  # Without a position, pings are recorded and shown, not mapped. A vehicle that stays at one spot
  # maps with owners.position: fixed; one near walls, piles or wrecks with sonar: {enabled: true}
"""


def settings_text(setup: Setup) -> str:
    """Return the settings of a vehicle as commented YAML.

    They are complete: every set-up writes the same names, so that a file on top of another one
    leaves nothing of that one's vehicle and server.
    """
    water = WATERS[setup.water]
    autopilot = AUTOPILOT.format(density=water.density)
    sources, note = {"native": NATIVE, "nmea": NMEA}.get(setup.vehicle, autopilot), ""
    owners = dict.fromkeys(("position", "attitude", "depth", "velocity"), ANY)
    if setup.fixed:
        owners["position"] = FIXED
    if setup.vehicle == "bluerov2" and setup.dvl == "water-linked":
        sources = autopilot + DVL.format(dvl_address=setup.dvl_address)
        if not setup.fixed:
            owners |= {
                "attitude": "autopilot",
                "depth": "autopilot # by pressure",
                "velocity": "dvl",
            }
    elif setup.vehicle == "bluerov2" and setup.dvl == "none" and not setup.fixed:
        note = MAYBE_FIXED
    x, y, z = setup.position
    roll, pitch, yaw = setup.orientation
    return TEMPLATE.format(
        x=x,
        y=y,
        z=z,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        sonar=setup.sonar,
        range_m=setup.range_m,
        salinity=water.salinity,
        map_path=_path_in(setup.folder, "mapperd.map"),
        recordings=_path_in(setup.folder, "recordings"),
        sources=sources,
        owners=note + OWNERS.format(**owners),
        server=_server(setup),
    )


def _path_in(folder: str, name: str) -> str:
    return json.dumps(str(Path(folder).absolute() / name) if folder else "", ensure_ascii=False)


def _server(setup: Setup) -> str:
    entry = '"" # none'
    if setup.token is not None:
        entry = f"{json.dumps(str(setup.token))} # other computers need a copy of it"
    elif setup.stream and not is_loopback(str(address_of(setup.stream)[0])):
        entry = '"" # it is systemd\'s credential `server-token`'
    alone = "" if setup.stream else ' # "" serves this computer alone, by a socket'
    return (
        "server: # map, page and commands for other programs\n"
        f'  address: "{setup.stream}"{alone}\n'
        f"  token_file: {entry}\n"
    )


def init(argv: Sequence[str]) -> int:
    """Run `mapperd init`; return its exit code."""
    parser = init_parser()
    args = parser.parse_args(argv)
    if args.service and args.file:
        parser.error("FILE or --service, not both")
    path = SERVICE_SETTINGS if args.service else args.file or user_settings(os.environ)
    if path is None:
        parser.error("there is no HOME to write settings to: name a FILE")
    if path.exists() and not args.force:
        return _fail(f"{path}: exists; --force replaces it", ExitCode.CANNOT_WRITE)
    try:
        setup = _asked(args) if sys.stdin.isatty() and not args.yes else _given(args)
    except (KeyboardInterrupt, EOFError):
        return _fail("interrupted; nothing was written", ExitCode.INTERRUPTED)
    token = SERVICE_TOKEN if args.service else path.absolute().parent / "token"
    needs_token = bool(setup.stream) and not is_loopback(str(address_of(setup.stream)[0]))
    if needs_token and not args.service:
        setup = replace(setup, token=token)
    text = settings_text(setup)
    try:
        config = config_from_text(text)
    except ConfigError as error:
        return _fail(_short(error), ExitCode.USAGE)
    try:
        if needs_token:
            _write_token(token)
        _write(path, text.encode(), 0o644)
    except (OSError, ExportError) as error:
        return _fail(_why(error, path), ExitCode.CANNOT_WRITE)
    command = "" if args.file is None else f" --config {path}"
    for line in _next_steps(setup, config, path, token if needs_token else None, command):
        print(line)  # noqa: T201 a command speaks
    return 0


def user_settings(environ: Mapping[str, str]) -> Path | None:
    """Return the user's settings file, None without a home folder."""
    folder = user_folder(environ)
    return None if folder is None else folder / "mapperd.yaml"


def init_parser() -> CommandParser:
    """Return the parser of `mapperd init`."""
    default = Setup()
    parser = CommandParser(
        "mapperd init",
        description="Write commented settings for a vehicle and its sonar, and a token for other "
        "computers. On a terminal it asks for what the options leave out.",
        epilog="exit codes: 0 written; 2 usage error; 73 cannot write, or the file exists; "
        "130 interrupted",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add(
        "file",
        metavar="FILE",
        type=Path,
        nargs="?",
        help="settings file to write (default: the user's, which `mapperd` reads by itself)",
    )
    add("--service", action="store_true", help=f"write {SERVICE_SETTINGS}, for the service")
    add("--force", action="store_true", help="replace the file")
    add("--yes", action="store_true", help="ask nothing; options that are left out have defaults")
    add("--vehicle", choices=VEHICLES, help=_listed(VEHICLES))
    add("--dvl", choices=DVLS, help=_listed(DVLS))
    add(
        "--dvl-address",
        metavar="HOST",
        default=default.dvl_address,
        help=f"address of a Water Linked DVL (default: {default.dvl_address})",
    )
    add(
        "--fixed",
        action="store_true",
        help="the vehicle stays at one spot: map with attitude and depth alone",
    )
    add("--sonar", metavar="ADDRESS", help="address of the sonar; `any` finds it by its broadcasts")
    add(
        "--position",
        metavar="X,Y,Z",
        type=_three,
        help="position of the sonar, m: forward, port, up",
    )
    add(
        "--orientation",
        metavar="ROLL,PITCH,YAW",
        type=_three,
        help="orientation of the sonar, degrees; pitch 0 looks ahead, 90 down",
    )
    add("--range", metavar="M", type=_number, help="range of the pings, m")
    add("--water", choices=WATERS, help="kind of water; sets the speed of sound")
    add(
        "--folder",
        metavar="DIR",
        help="folder of the map and the recordings (default: the state folder, the user's or the "
        "service's)",
    )
    add(
        "--stream",
        metavar="HOST:PORT",
        type=_stream,
        help=f"serve map and commands there; {NO_STREAM}: on this computer alone "
        f"(default: {default.stream}, with a token)",
    )
    parser.add_argument("--version", action="version", version=f"mapperd {__version__}")
    return parser


def _listed(choices: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {text}" for name, text in choices.items())


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r}: a number was expected")
    return value


def _three(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (_number(part) for part in text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"{text!r}: three numbers were expected, such as 0.2,0,-0.15"
        ) from None
    return x, y, z


def _stream(text: str) -> str:
    if text == NO_STREAM:
        return ""
    try:
        address_of(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def _sonar(text: str) -> str:
    return "" if text == "any" else text


def _given(args: argparse.Namespace) -> Setup:
    """Return what the options give, and defaults for the rest."""
    return replace(Setup(), **_options(args))


def _options(args: argparse.Namespace) -> dict[str, Any]:
    options: dict[str, Any] = {"dvl_address": args.dvl_address, "fixed": args.fixed}
    if args.sonar is not None:
        options["sonar"] = _sonar(args.sonar)
    if args.range is not None:
        options["range_m"] = args.range
    for name in ("vehicle", "dvl", "position", "orientation", "water", "folder", "stream"):
        if (value := getattr(args, name)) is not None:
            options[name] = value
    return options


def _asked(args: argparse.Namespace) -> Setup:
    """Return what the options give, and ask for the rest.

    Raises:
        EOFError, KeyboardInterrupt: the user leaves.
    """
    options = _options(args)
    setup = replace(Setup(), **options)

    def ask(name: str, question: str, default: str, read: Callable[[str], Any]) -> None:
        nonlocal setup
        if name not in options:
            setup = _answer(
                question, default, lambda text: _checked(replace(setup, **{name: read(text)}))
            )

    ask("vehicle", f"{_menu(VEHICLES)}Vehicle", setup.vehicle, _one_of(VEHICLES))
    if setup.vehicle == "bluerov2":
        ask("dvl", f"{_menu(DVLS)}DVL", setup.dvl, _one_of(DVLS))
        if setup.dvl == "none" and not setup.fixed:
            question = "Does the vehicle stay at one spot while it maps (yes, no)"
            setup = replace(setup, fixed=_answer(question, "no", _one_of(["yes", "no"])) == "yes")
    if "sonar" not in options:
        print("Listening for sonars ...")  # noqa: T201 a dialogue
        heard = asyncio.run(listen(odometry_ports=()))
        print("\n".join(f"  {line}" for line in sonar_lines(heard)))  # noqa: T201
    ask("sonar", "Address of the sonar; any finds it by its broadcasts", "any", _sonar)
    question = "Position of the sonar on the vehicle, m: forward, port, up"
    ask("position", question, _joined(setup.position), _three)
    question = "Roll, pitch and yaw of the sonar, degrees; pitch 0 looks ahead, 90 down"
    ask("orientation", question, _joined(setup.orientation), _three)
    ask("range_m", "Range of the pings, m", f"{setup.range_m:g}", _number)
    ask("water", "Water (sea, fresh)", setup.water, _one_of(WATERS))
    question = f"Serve map and commands on the network at; {NO_STREAM}: on this computer alone"
    ask("stream", question, setup.stream, _stream)
    return setup


def _checked(setup: Setup) -> Setup:
    """Return the set-up, if the settings of it are valid."""
    try:
        config_from_text(settings_text(setup))
    except ConfigError as error:
        raise argparse.ArgumentTypeError(_short(error)) from error
    return setup


def _short(error: ConfigError) -> str:
    return str(error).removeprefix("config: ").removeprefix("$.")


def _menu(choices: Mapping[str, str]) -> str:
    return "".join(f"  {name:<13} {text}\n" for name, text in choices.items())


def _joined(numbers: tuple[float, ...]) -> str:
    return ",".join(f"{number:g}" for number in numbers)


def _one_of(choices: Sequence[str] | Mapping[str, object]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in choices:
            raise argparse.ArgumentTypeError(f"{text!r}: one of {', '.join(choices)} was expected")
        return text

    return read


def _answer(question: str, default: str, read: Callable[[str], Any]) -> Any:  # noqa: ANN401 as `read`
    """Ask until the answer can be read; an empty one is the default."""
    while True:
        answer = input(f"{question} [{default}]: ").strip() or default
        try:
            return read(answer)
        except argparse.ArgumentTypeError as error:
            print(f"  {error}")  # noqa: T201 a dialogue


def _write_token(path: Path) -> None:
    """Write a random token, unless there is one already."""
    if not path.exists():
        _write(path, f"{secrets.token_hex(32)}\n".encode(), 0o600)


def _write(path: Path, data: bytes, mode: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        os.fchmod(file.fileno(), mode)
        file.write(data)


def _why(error: OSError | ExportError, path: Path) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or path}: cannot be written: {error.strerror}"
    return str(error)


def _next_steps(
    setup: Setup, config: Config, path: Path, token: Path | None, command: str
) -> list[str]:
    lines = [f"wrote {path}" + ("" if token is None else f" and {token}")]
    try:
        check_libraries(config.odometry, decoding=True)
    except ConfigError as error:
        lines.append(str(error))
    if setup.vehicle == "bluerov2":
        lines.append('in BlueOS, add a MAVLink endpoint "UDP client": this computer, port 52210')
        if setup.dvl == "none" and not setup.fixed:
            lines.append(
                "without a DVL or another position, pings are recorded and shown, not mapped; "
                "--fixed maps from one spot, odometry.sonar.enabled near walls, piles or wrecks"
            )
    lines += ["next:", f"  mapperd doctor{command}"]
    lines += [
        "  systemctl enable --now mapperd" if path == SERVICE_SETTINGS else f"  mapperd{command}",
        "  mapperctl view --open",
    ]
    if token is not None:
        _, port = address_of(setup.stream)
        lines += [
            f"on other computers, with a copy of {token}:",
            f"  mapperctl view --address THIS_COMPUTER:{port} --token-file token --open",
        ]
    return lines


def _fail(message: str, code: int) -> int:
    print(f"mapperd init: {message}", file=sys.stderr)  # noqa: T201
    return code
