"""The run's figures as Markdown, between two marks of docs/performance.md."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from contenders import CONTENDERS, Contender
from measured import Measured, figure
from results import CaseResult, Results
from targets import verdicts

BEGIN = "<!-- measured: written by tools/bench/rivals.py, do not edit -->"
END = "<!-- end of measured -->"

Row = Sequence[str]


def markdown(results: Results) -> str:
    """All tables of a run."""
    parts = [_machine(results), "## Asked and found", _verdicts(results)]
    for case in results.cases:
        parts += [f"## {case.name}", _case(case, results.machine.bytes_a_second, results.pings)]
    parts += ["## What sampling and the default error bound cost", _accuracy(results)]
    parts += ["## Open water, 10 cm", _open_water(results)]
    return "\n\n".join(parts)


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
        f"`{results.command}` at commit `{at.commit}`: {results.pings} pings a case, seed "
        f"{results.seed}. {at.cpu}, {at.cores} cores, load {at.load:.1f} before the run; "
        f"{at.compiler}. Streaming read-modify-write of one thread: "
        f"{at.bytes_a_second / 1e9:.1f} GB/s, read and written bytes together. "
        f"The default `mapping.error_bound` is {results.error_bound:g}."
    )


def _table(head: Row, rows: Sequence[Row]) -> str:
    """The first column is text, the others are figures."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *rows))


def _verdicts(results: Results) -> str:
    rows = [(v.wish, v.found, "yes" if v.met else "**no**") for v in verdicts(results)]
    return _table(("asked", "found", "met"), rows)


def _case(case: CaseResult, bytes_a_second: float, pings: int) -> str:
    head = ["map", "takes", "threads", "ms median", "ms p95", "voxels a ping", "Mvoxel/s"]
    head += ["bytes a voxel", "peak RSS MB", "times the bound"]
    rows = [
        _run(contender, case.runs[contender.name], bytes_a_second, pings)
        for contender in CONTENDERS
        if contender.name in case.runs
    ]
    return _table(head, rows)


def _run(contender: Contender, run: Measured, bytes_a_second: float, pings: int) -> Row:
    fewer = "" if len(run.ms) == pings else f" ({len(run.ms)} pings)"
    rss_mb, start_mb = run.peak_rss_bytes / 1e6, run.start_rss_bytes / 1e6
    return (
        contender.map_name,
        contender.takes,
        f"{contender.threads}",
        f"{figure(run.median_ms)}{fewer}",
        figure(run.p95_ms),
        f"{run.touched_a_ping / 1e3:,.0f} k",
        figure(run.touched_a_second / 1e6),
        f"{run.bytes_a_voxel:.1f}",
        f"{rss_mb:.0f} ({rss_mb - start_mb:.0f})",
        figure(run.median_ms / run.bound_ms(bytes_a_second)),
    )


def _accuracy(results: Results) -> str:
    head = ["case", "takes", "integrator", "other class", "known to one only", "mean"]
    head += ["95th percentile", "mean where both know", "pings"]
    return _table(head, list(_accuracy_rows(results)))


def _accuracy_rows(results: Results) -> Iterator[Row]:
    for case in results.cases:
        for takes, ways in case.accuracy.items():
            for way, found in ways.items():
                shares = (f"{found.class_share:.3%}", f"{found.one_only_share:.3%}")
                errors = (found.mean, found.p95, found.mean_of_shared)
                cells = (*shares, *(f"{error:.2g}" for error in errors), f"{found.pings}")
                yield (case.name, takes, way, *cells)


def _open_water(results: Results) -> str:
    ranges = list(next(iter(results.open_water.values())))
    head = ("integrator", *(f"{range_m} m" for range_m in ranges))
    rows = [
        (way, *(f"{figure(ms)} ms" for ms in times_ms.values()))
        for way, times_ms in results.open_water.items()
    ]
    return _table(head, rows)
