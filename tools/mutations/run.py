"""Breaks each formula of the catalogue once in a copy and runs its tests.

    PYTHONPATH=tools python -m studies mutations [--only 'localization/*'] [--language cpp]
        [--again] [--write]

It uses the last commit; uncommitted changes do not count. The copy and its build are in
build/mutations, with a folder for each language, so that both can run at once. Results are in
out/mutations/results.jsonl. A mutation is measured again if it, its file or the file of its test
changed. Exit code 1: a mutation survives without a reason.
"""

import argparse
import fnmatch
import os
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

from studies.report import PAGES, write_section
from tqdm import tqdm

from mutations.broken_copy import Copy, NotBuiltError
from mutations.catalogue import REPOSITORY, Mutation, load
from mutations.judge import End, is_endless, program_of, run_test, targets_of
from mutations.results import MutationResults, Result, is_well, table
from mutations.stamp import stamp

MAX_BYTES = 8 << 30
"""Memory limit of a program, against endless loops."""


class Check:
    """Measures mutations, one after another."""

    def __init__(self, copy: Copy) -> None:
        self._copy = copy
        self._whole: dict[str, End] = {}

    def run(self, mutation: Mutation) -> Result:
        """Break the file, build, test, and restore the file."""
        began_s = time.monotonic()
        try:
            outcome, test, words = self._measured(mutation)
        except (NotBuiltError, ValueError) as error:
            outcome, test, words = "broken", "", str(error)
        seconds = round(time.monotonic() - began_s, 1)
        tests = (test,) if test else mutation.killed_by
        now = stamp(mutation, tests, self._copy.root)
        return Result(mutation.name, outcome, test, words, seconds, self._copy.commit, now)

    def _measured(self, mutation: Mutation) -> tuple[str, str, str]:
        for test in mutation.killed_by:
            self._copy.keep_whole(program_of(test))
        with self._copy.broken(mutation):
            test, end = self._first_to_notice(mutation)
        if end.how == "passed":
            return "survived", "", ""
        whole = self._whole_end(test)
        if whole.how != "passed":
            return "broken", test, f"unbroken, {test} ends so: {whole.how} {whole.words}"
        outcome, words = self._outcome(mutation, end, whole)
        return outcome, test, words

    def _first_to_notice(self, mutation: Mutation) -> tuple[str, End]:
        """Return the first test that does not pass and its end; otherwise the end of the last."""
        test, end = "", End("passed")
        for test in mutation.killed_by:
            self._copy.build(targets_of(test))
            end = run_test(self._copy, test, mutation)
            if end.how != "passed":
                break
        return test, end

    def _outcome(self, mutation: Mutation, end: End, whole: End) -> tuple[str, str]:
        if end.how == "failed" and not mutation.is_cpp and not end.imported:
            return "broken", f"{mutation.file} was not imported: {end.words}"
        failed = end.how in ("failed", *mutation.may) or is_endless(end, whole)
        return ("killed" if failed else "broken"), f"{end.how}: {end.words}"

    def _whole_end(self, test: str) -> End:
        """Return how a test ends without a mutation; measured once."""
        if test not in self._whole:
            if not program_of(test):
                self._copy.build(targets_of(test))
            began_s = time.monotonic()
            end = run_test(self._copy, test, None)
            self._whole[test] = replace(end, seconds=time.monotonic() - began_s)
        return self._whole[test]


def main(words: Sequence[str] | None = None) -> int:
    """Run the check."""
    parser = argparse.ArgumentParser(prog="mutations", description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="*", metavar="GLOB", help="of names of mutations")
    parser.add_argument("--language", choices=("cpp", "python"), help="of the broken files")
    parser.add_argument("--again", action="store_true", help="also what is as it was measured")
    parser.add_argument("--write", action="store_true", help="write the tables into the page")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="of the compiler")
    args = parser.parse_args(words)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    results = MutationResults(REPOSITORY / "out" / "mutations" / "results.jsonl")
    mutations = load()
    chosen = [one for one in mutations if _is_chosen(one, args.only, args.language)]
    beside = f"-{args.language}" if args.language else ""
    copy = Copy(REPOSITORY / "build" / f"mutations{beside}", args.jobs)
    due = [one for one in chosen if args.again or not results.is_done(one, copy.root)]
    due.sort(key=lambda one: results.of(one) is not None)  # mutations without any result come first
    print(f"{len(due)} of {len(chosen)} mutations to measure at {copy.commit}")
    _measure(copy, due, results)
    if args.write:
        write_section(PAGES["mutations"], "mutations", table(mutations, results))
    unwell = [one for one in chosen if not is_well(one, results.of(one))]
    for one in unwell:
        print(f"{one.name}: {results.of(one)}\n  {one.survives or one.breaks}")
    print(f"{len(chosen) - len(unwell)} of {len(chosen)} are as they must be")
    return 1 if unwell else 0


def _is_chosen(mutation: Mutation, names: str, language: str | None) -> bool:
    if language is not None and (language == "cpp") != mutation.is_cpp:
        return False
    return fnmatch.fnmatch(mutation.name, names)


def _measure(copy: Copy, mutations: Sequence[Mutation], results: MutationResults) -> None:
    if not mutations:
        return
    copy.configure()
    check = Check(copy)
    with tqdm(mutations, unit="mutation", dynamic_ncols=True) as bar:
        for mutation in bar:
            bar.set_description(mutation.name)
            result = check.run(mutation)
            results.add(result)
            if not is_well(mutation, result):
                bar.write(f"{mutation.name}: {result.outcome} {result.words}")


if __name__ == "__main__":
    sys.exit(main())
