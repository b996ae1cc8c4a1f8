"""Run one of several programs by its name: `python -m studies NAME`, `python -m bench NAME`."""

import importlib
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

__all__ = ["do_all", "run_program"]

J = TypeVar("J")


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


def do_all(work: Callable[[J], str], jobs: Sequence[J], processes: int, unit: str) -> None:
    """Do all jobs, in this process or in several, and print what each returns."""
    from tqdm import tqdm  # noqa: PLC0415 benchmarks need none

    with tqdm(total=len(jobs), unit=unit, disable=None) as bar:
        for text in _results(work, jobs, processes):
            bar.update()
            tqdm.write(text)


def _results(work: Callable[[J], str], jobs: Iterable[J], processes: int) -> Iterator[str]:
    if processes == 1:
        yield from map(work, jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context) as pool:
        yield from pool.map(work, jobs)
