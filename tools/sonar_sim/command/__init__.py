"""The command `sonar-sim`: one file for each of its subcommands."""

import argparse
import sys
from collections.abc import Sequence

from oculus_driver import __version__
from oculus_driver.command_line import CommandParser, ExitCode
from oculus_driver.errors import OculusError, RecordingUnwritableError, missing_extra
from sonar_sim.errors import SceneError, SceneMissingError, SonarSimError

__all__ = ["main"]

EPILOG = """\
examples:
  sonar-sim serve harbour
  sonar-sim capture tank --out tank.mcap
  sonar-sim render wreck --out out/wreck --pings 3

exit codes: 0 success; 1 failure; 2 invalid command; 66 no such scene file; 73 cannot write; 78
invalid scene or a missing extra; 130 interrupted"""

VERSION = f"sonar-sim {__version__}"
HELP_WORDS = ("-h", "--help", "--version")
"""First words of command lines that need no extra."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; every failure that input can cause is one line and an exit code."""
    try:
        parser = _parser()
    except ModuleNotFoundError as error:
        words = sys.argv[1:] if argv is None else argv
        if words and words[0] in HELP_WORDS:
            _top().parse_args(argv)
        return _failure(missing_extra(str(error.name), "sim"), ExitCode.BAD_CONFIG)
    args = parser.parse_args(argv)
    try:
        return int(args.run(args))
    except (SonarSimError, OculusError, OSError) as error:
        return _failure(error, _exit_code_of(error))
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED


def _exit_code_of(error: Exception) -> ExitCode:
    codes = {
        SceneMissingError: ExitCode.NO_INPUT,
        SceneError: ExitCode.BAD_CONFIG,
        SonarSimError: ExitCode.USAGE,
        RecordingUnwritableError: ExitCode.CANNOT_WRITE,
        OculusError: ExitCode.FAULT,
    }
    found = (code for kind, code in codes.items() if isinstance(error, kind))
    return next(found, ExitCode.CANNOT_WRITE)


def _failure(error: Exception | str, code: int) -> int:
    sys.stderr.write(f"sonar-sim: {error}\n")
    return code


def _parser() -> argparse.ArgumentParser:
    from sonar_sim.command import (  # noqa: PLC0415 of an extra
        capture,
        explain,
        render,
        scene_list,
        serve,
        validate,
    )

    parser = _top()
    parser.add_completion()
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in (scene_list, explain, render, capture, serve, validate):
        command = commands.add_parser(
            module.NAME, help=module.HELP, description=module.HELP, allow_abbrev=False
        )
        command.set_defaults(run=module.run)
        module.add_arguments(command)
    parser.add_version(VERSION)
    return parser


def _top() -> CommandParser:
    """Return the parser without the subcommands."""
    parser = CommandParser(
        prog="sonar-sim",
        description="Simulate an Oculus sonar in a scene: pictures, recordings, a live device.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=VERSION)
    return parser
