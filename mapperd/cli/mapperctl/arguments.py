"""The command line of `mapperctl`."""

import argparse
from pathlib import Path
from typing import NoReturn

from mapperd.cli.mapperctl.file_arguments import add_bag, add_convert, add_export
from mapperd.cli.mapperctl.foxglove_arguments import add_foxglove, add_record
from mapperd.cli.mapperctl.localization_arguments import add_localization
from mapperd.cli.mapperctl.view_arguments import add_view
from mapperd.config.catalog import parameters
from mapperd.config.yaml_strict import YamlProblem, parse_yaml
from mapperd.errors import ConfigError

__all__ = ["parser"]

EPILOG = """exit codes: 0 done; 1 the daemon refuses; 2 the command cannot be done as given; 69 no
daemon answers; 73 it cannot write; 75 try again later; 76 it speaks another language; 77 you may
not; 78 the settings are wrong; 130 interrupted"""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser() -> _Parser:
    """All commands."""
    top = _Parser("mapperctl", description="Look at a mapper and steer it.", epilog=EPILOG)
    commands = top.add_subparsers(metavar="COMMAND", required=True, dest="command")
    status = _command(commands, "status", "how it goes")
    status.add_argument("--once", action="store_true", help="do not go on")
    status.add_argument("--every", metavar="S", type=_seconds, default=1.0, help="default: 1 s")
    _params(commands)
    get = _command(commands, "get", "values of settings in force")
    get.add_argument("names", metavar="NAME", nargs="+", type=_name, help="a setting or a section")
    change = _command(commands, "set", "change settings of the running daemon, all or none")
    change.add_argument("changes", metavar="NAME=VALUE", nargs="+", type=_change)
    save = _command(commands, "save", "write the map into the daemon's folder for maps")
    save.add_argument("name", metavar="FILE", help="the suffix says the format: docs/control.md")
    reset = _command(commands, "reset", "empty the map")
    reset.add_argument("--yes", action="store_true", help="do not ask")
    _command(commands, "reload", "read the settings' files again")
    _command(commands, "snapshot", "bring the map and the recording to the disk now")
    stream = "--socket and --address are those of the map stream."
    about = "the live map as a page in the browser"
    add_view(_command(commands, "view", about, f"{about.capitalize()}. {stream}"))
    about = "serve Foxglove and Lichtblick"
    add_foxglove(_command(commands, "foxglove", about, f"{about}. {stream}"))
    about = "record what the map stream says"
    add_record(_command(commands, "record", about, f"{about.capitalize()}. {stream}"))
    about = "the live map as a file here, in any format"
    add_export(_command(commands, "export", about, f"{about.capitalize()}. {stream}"))
    add_convert(_offline(commands, "convert", "a map's file to one of another format"))
    add_bag(_offline(commands, "bag", "a recording or a map to a ROS 2 bag, without ROS"))
    add_localization(lambda *said: _command(commands, *said))
    events = _command(commands, "events", "what happened")
    events.add_argument("--follow", action="store_true", help="and what happens, until interrupted")
    events.add_argument(
        "--since", metavar="N", type=_count, default=0, help="after the event of this number"
    )
    return top


def _params(commands: "argparse._SubParsersAction[_Parser]") -> None:
    params = _command(
        commands,
        "params",
        "all about the settings",
        "The settings that a mapper started now would have, by its files; with --running, --socket "
        "or --address those in force in the running one.",
    )
    add = params.add_argument
    add("names", metavar="NAME", nargs="*", type=_name, help="a setting or a section of them")
    add("--origin", action="store_true", help="also who said each")
    add("--running", action="store_true", help="of the running daemon")


def _command(
    commands: "argparse._SubParsersAction[_Parser]",
    name: str,
    about: str,
    more: str | None = None,
) -> _Parser:
    command = _offline(commands, name, about, more)
    add = command.add_argument
    add("--json", action="store_true", help="for programs: objects, one a line")
    add("--socket", metavar="PATH", type=Path, help="Unix socket of the daemon")
    add("--address", metavar="HOST:PORT", help="its TCP socket instead")
    add("--token-file", metavar="FILE", type=Path, help="token of the TCP socket")
    add("--tls-ca", metavar="PEM", type=Path, help="TLS, by an authority or certificate of these")
    return command


def _offline(
    commands: "argparse._SubParsersAction[_Parser]",
    name: str,
    about: str,
    more: str | None = None,
) -> _Parser:
    """A command that needs no daemon."""
    command = commands.add_parser(
        name, help=about, description=more or f"{about.capitalize()}.", epilog=EPILOG
    )
    command.add_argument(
        "--config",
        metavar="YAML",
        type=Path,
        action="append",
        default=[],
        help="as mapperd was given; may be said again, the last one on top",
    )
    return command


def _name(text: str) -> str:
    if not any(name == text or name.startswith(f"{text}.") for name in parameters()):
        raise argparse.ArgumentTypeError(f"{text!r}: there is no such setting")
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


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 3600:  # noqa: PLR2004 written in the message
        raise argparse.ArgumentTypeError(f"{text!r}: 0.1 to 3600 seconds were expected")
    return value
