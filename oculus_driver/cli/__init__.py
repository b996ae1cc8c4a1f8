"""The command `oculus`: one module per subcommand."""

from __future__ import annotations

import argparse
import errno
from typing import TYPE_CHECKING

from oculus_driver import __version__
from oculus_driver.cli import (
    convert,
    discover,
    doctor,
    fire,
    info,
    log,
    play,
    render,
    watch,
)
from oculus_driver.cli.output import Output, discard_stdout
from oculus_driver.command_line import CommandParser, ExitCode
from oculus_driver.errors import (
    ExtraMissingError,
    OculusError,
    RecordingError,
    RecordingMissingError,
    RecordingUnwritableError,
    SettingsError,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

SUBCOMMANDS = (discover, watch, log, info, play, convert, render, fire, doctor)

EPILOG = """\
examples:
  oculus discover --first
  oculus log --out dive1 --range 20
  oculus info dive.mcap
  oculus render dive.mcap dive.mp4

exit codes: 0 success; 1 the sonar or the link failed, see the message; 2 invalid arguments;
65 not a recording, or a damaged part is left out; 66 no such file; 73 cannot write; 78 a missing
extra; 130 interrupted"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Every failure caused by input is one line and an exit code."""
    args = _parser().parse_args(argv)
    output = Output(as_json=args.json)
    try:
        return int(args.run(args, output))
    except OculusError as error:
        return output.failure(error, _exit_code_of(error))
    except OSError as error:
        return _end_of_output(error, output)
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED


def _exit_code_of(error: OculusError) -> ExitCode:
    codes = {
        SettingsError: ExitCode.USAGE,
        ExtraMissingError: ExitCode.BAD_CONFIG,
        RecordingMissingError: ExitCode.NO_INPUT,
        RecordingUnwritableError: ExitCode.CANNOT_WRITE,
        RecordingError: ExitCode.BAD_DATA,
    }
    return next((code for kind, code in codes.items() if isinstance(error, kind)), ExitCode.FAULT)


def _end_of_output(error: OSError, output: Output) -> ExitCode:
    """Handle a closed or full standard output."""
    if not isinstance(error, BrokenPipeError) and error.errno != errno.ENOSPC:
        raise error
    discard_stdout()
    if isinstance(error, BrokenPipeError):
        return ExitCode.OK
    return output.failure(f"standard output: {error}", ExitCode.CANNOT_WRITE)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="oculus",
        description="Discover, watch, log, play back and check Oculus multibeam sonars.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_completion()
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in SUBCOMMANDS:
        command = commands.add_parser(
            module.NAME, help=module.HELP, description=module.HELP, allow_abbrev=False
        )
        command.add_argument(
            "--json", action="store_true", help="write JSON to standard output, one object per line"
        )
        command.set_defaults(run=module.run)
        module.add_arguments(command)
    parser.add_version(f"oculus {__version__}")
    return parser
