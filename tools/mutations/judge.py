"""Runs tests in the copy and reports how they ended."""

import re
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

from mutations.broken_copy import MODULES, Copy
from mutations.catalogue import Mutation
from mutations.forked import run_forked

__all__ = [
    "TEST_TIMEOUT_S",
    "End",
    "is_endless",
    "judge_cpp",
    "judge_pytest",
    "program_of",
    "run_test",
    "targets_of",
]

TEST_TIMEOUT_S = 120.0
# Output of a test that a mutation broke in an unintended way.
NO_FAILURE = re.compile(r"\b(SyntaxError|NameError|ImportError|ModuleNotFoundError)\b")


@dataclass(frozen=True, slots=True)
class End:
    """How a test ended.

    Attributes:
        how: "passed", "failed", "hang", "crash" or "broken".
        words: its output.
        imported: whether it imported the mutated file.
        seconds: its duration, if measured.
    """

    how: str
    words: str = ""
    imported: bool = False
    seconds: float = 0.0


MAX_SHARE = 0.25
"""Share of the time limit; a slower test is no evidence of an endless loop."""

HANG = End("hang", f"no end within {TEST_TIMEOUT_S:.0f} s")


def targets_of(test: str) -> tuple[str, ...]:
    """Return the targets to build before a test."""
    program = program_of(test)
    return (program,) if program else MODULES


def program_of(test: str) -> str:
    """Return the C++ test program of an entry of `killed_by`; "" for pytest."""
    return "" if test.startswith("tests/") else test.partition(":")[0]


def run_test(copy: Copy, test: str, mutation: Mutation | None) -> End:
    """Run one entry of `killed_by`."""
    environment = copy.environment(mutation)
    if test.startswith("tests/"):
        options = ["-q", "-x", "-rfE", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
        words = [*options, *test.split()]
        code, printed = run_forked(words, copy.root, environment, TEST_TIMEOUT_S)
        end = HANG if code is None else judge_pytest(code, printed)
        return replace(end, imported=copy.was_imported)
    program, _, case = test.partition(": ")
    folder = copy.whole if mutation is None else copy.build_tree / "test"
    try:
        ended = subprocess.run(  # noqa: S603
            [str(folder / program), f"--test-case={_pattern(case)}", "--no-colors"],
            cwd=copy.root,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=TEST_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return HANG
    return judge_cpp(ended.returncode, ended.stdout)


def is_endless(end: End, whole: End) -> bool:
    """Whether a mutation makes a test reach the time limit, rather than a slow test or a busy host.

    The test must pass without the mutation (`whole`) in a fraction of the time limit.
    """
    return end.how == "hang" and whole.seconds < MAX_SHARE * TEST_TIMEOUT_S


def judge_pytest(code: int, out: str) -> End:
    """Judge by pytest's exit code and short summary."""
    if code == 0:
        return End("passed")
    failed = re.findall(r"^FAILED (.*)$", out, re.MULTILINE)
    if code < 0:
        return End("crash", f"signal {-code}")
    if code != 1 or not failed:
        return End("broken", out[-1500:])
    if "Timeout" in failed[0]:
        return End("hang", failed[0])
    return End("broken" if NO_FAILURE.search(failed[0]) else "failed", failed[0])


def _pattern(case: str) -> str:
    """Return doctest's filter for the cases whose names contain `case`."""
    return f"*{case.replace(',', chr(92) + ',')}*"


def judge_cpp(code: int, out: str) -> End:
    """Judge by doctest's exit code and summary."""
    if code < 0:
        return End("crash", f"signal {-code}")
    summary = re.search(r"^\[doctest\] test cases: +(\d+) ", out, re.MULTILINE)
    if code not in (0, 1) or summary is None or summary[1] == "0":
        return End("broken", out[-1500:])
    if code == 0:
        return End("passed")
    first = re.search(r"^(\S+\.cpp:\d+): (?:FATAL )?ERROR: .*$", out, re.MULTILINE)
    return End("failed", Path(first[0]).name if first else summary[0])
