"""Run one of several programs by its name: `python -m studies NAME`, `python -m bench NAME`."""

import importlib
import sys
from collections.abc import Mapping, Sequence

__all__ = ["run_program"]


def run_program(package: str, programs: Mapping[str, str], argv: Sequence[str]) -> int:
    """Import the program's module and call its `main`; return the exit code.

    Args:
        package: name of the package, for the usage line.
        programs: name of each program to its module.
        argv: name of a program and its arguments.
    """
    if not argv or argv[0] not in programs:
        names = "\n  ".join(programs)
        sys.stderr.write(f"usage: python -m {package} NAME [ARGUMENTS]\n\nnames:\n  {names}\n")
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    name, *arguments = argv
    sys.argv = [f"{package} {name}", *arguments]
    return int(importlib.import_module(programs[name]).main() or 0)
