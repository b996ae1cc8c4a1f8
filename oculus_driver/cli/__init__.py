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
from oculus_driver.cli.output import Exit, Output, discard_stdout
from oculus_driver.command_line import CommandParser
from oculus_driver.errors import OculusError, RecordingError, SettingsError

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
65 the file is not a recording, or a part of it is damaged and left out; 130 interrupted"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Every failure caused by input is one line and an exit code."""
    args = _parser().parse_args(argv)
    output = Output(as_json=args.json)
    try:
        return int(args.run(args, output))
    except SettingsError as error:
        return output.failure(error, Exit.USAGE)
    except RecordingError as error:
        return output.failure(error, Exit.BAD_DATA)
    except OculusError as error:
        return output.failure(error, Exit.FAULT)
    except OSError as error:
        return _end_of_output(error, output)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED


def _end_of_output(error: OSError, output: Output) -> Exit:
    """Handle a closed or full standard output."""
    if not isinstance(error, BrokenPipeError) and error.errno != errno.ENOSPC:
        raise error
    discard_stdout()
    if isinstance(error, BrokenPipeError):
        return Exit.OK
    return output.failure(f"standard output: {error}", Exit.FAULT)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="oculus",
        description="Discover, watch, log, play back and check Oculus multibeam sonars.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"oculus {__version__}")
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
    return parser
