"""The run's figures as Markdown, between two marks of docs/performance.md."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import bench_tables as tables
from results import CaseResult, Results
from targets import Verdict, verdicts

BEGIN = "<!-- measured: written by tools/bench/rivals.py, do not edit -->"
END = "<!-- end of measured -->"


def markdown(results: Results) -> str:
    """All tables of a run."""
    judged = verdicts(results)
    parts = [_machine(results), "## Asked and found", _verdicts([v for v in judged if v.asked])]
    parts += ["## For information", _verdicts([v for v in judged if not v.asked])]
    for look in dict.fromkeys(case.look for case in results.cases):
        cases = [case for case in results.cases if case.look == look]
        parts += [f"## Looking {look}", _loud(cases), tables.overview(cases)]
    parts += ["## Voxels and nanoseconds a voxel", tables.per_voxel(results.cases)]
    if any(case.accuracy for case in results.cases):
        parts += ["## What sampling and the default error bound cost", tables.accuracy(results)]
    if results.open_water:
        parts += ["## Open water, 10 cm", tables.open_water(results)]
    return "\n\n".join([*parts, "## Everything measured", *_all_cases(results)])


def put_into(page: Path, text: str) -> None:
    """Replace what stands between the marks.

    Raises:
        ValueError: the page has not both marks, in order.
    """
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page} has no section to write into: {BEGIN} ... {END}")
    page.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")


def _machine(results: Results) -> str:
    at = results.machine
    return (
        f"`{results.command}` at commit `{at.commit}`: up to {results.pings} pings a case, seed "
        f"{results.seed}. {at.cpu}, {at.cores} cores, load {at.load:.1f} before the run; "
        f"{at.compiler}. Streaming read-modify-write of one thread: "
        f"{at.bytes_a_second / 1e9:.1f} GB/s, read and written bytes together. "
        f"The default `mapping.error_bound` is {results.error_bound:g}."
    )


def _verdicts(judged: Sequence[Verdict]) -> str:
    rows = [(v.wish, v.found, "yes" if v.met else "**no**") for v in judged]
    return tables.table(("asked", "found", "met"), rows)


def _loud(cases: Sequence[CaseResult]) -> str:
    shares = {case.range_m: case.loud_share for case in cases}
    said = ", ".join(f"{share:.1%} at {range_m:g} m" for range_m, share in shares.items())
    return f"Pixels above the threshold: {said}."


def _all_cases(results: Results) -> Iterator[str]:
    for case in results.cases:
        yield f"**{case.name}**, {case.loud_share:.1%} of the pixels above the threshold:"
        yield tables.case_table(case, results.machine.bytes_a_second, results.pings)
