"""Makes one map from many recordings, with the daemon's code, on one machine or a cluster."""

import sys
from collections.abc import Sequence

from mapperd.errors import missing_extra
from oculus_driver.command_line import ExitCode

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `mapper-survey`; a missing extra is one line and exit code 78."""
    try:
        from mapper_survey import command  # noqa: PLC0415 of an extra

        return command.main(argv)
    except ModuleNotFoundError as error:
        sys.stderr.write(f"mapper-survey: {missing_extra(str(error.name), 'survey')}\n")
        return ExitCode.BAD_CONFIG
