"""The command `oculus`: one file for each of its subcommands."""

from __future__ import annotations

import argparse
import errno
from typing import TYPE_CHECKING, NoReturn

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
from oculus_driver.errors import OculusError, RecordingError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

SUBCOMMANDS = (discover, watch, log, info, play, convert, render, fire, doctor)

EPILOG = """\
exit codes: 0 done; 1 something is wrong with the sonar or the link, as told; 2 the command cannot
be done as given; 65 the file is no recording; 130 interrupted"""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        self.exit(Exit.USAGE, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; every failure that input can cause is one line and an exit code."""
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
    """Whoever read our output has had enough, or there is no room for it."""
    if not isinstance(error, BrokenPipeError) and error.errno != errno.ENOSPC:
        raise error
    discard_stdout()
    if isinstance(error, BrokenPipeError):
        return Exit.OK
    return output.failure(f"standard output: {error}", Exit.FAULT)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="oculus",
        description="Find, watch, log, play and check Oculus multibeam sonars.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in SUBCOMMANDS:
        command = commands.add_parser(
            module.NAME, help=module.HELP, description=module.HELP, allow_abbrev=False
        )
        command.add_argument(
            "--json", action="store_true", help="write JSON, one object a line, to standard output"
        )
        command.set_defaults(run=module.run)
        module.add_arguments(command)
    return parser
