"""Makes one map from many recordings, with the daemon's code, on one machine or a cluster."""

import sys
from collections.abc import Sequence

from mapperd.errors import missing_extra

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `mapper-survey`; a missing extra is one line and exit code 2."""
    try:
        from mapper_survey import command  # noqa: PLC0415 of an extra
    except ModuleNotFoundError as error:
        sys.stderr.write(f"mapper-survey: {missing_extra(str(error.name), 'survey')}\n")
        return 2
    return command.main(argv)
