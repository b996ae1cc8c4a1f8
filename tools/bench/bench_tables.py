"""The tables of a run's cases: times and memory, voxels, accuracy."""

from collections.abc import Iterator, Sequence

from accuracy import Accuracy
from contenders import (
    CONTENDERS,
    DEFAULT_FIRST,
    EXACT_FIRST,
    OCTOMAP,
    OPENVDB,
    RAYS_FIRST,
    Contender,
)
from measured import Measured, figure
from results import CaseResult, Results

Row = Sequence[str]
ABSENT = "–"  # noqa: RUF001 a dash


def table(head: Row, rows: Sequence[Row]) -> str:
    """The first column is text, the others are figures."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *rows))


def overview(cases: Sequence[CaseResult]) -> str:
    """Median milliseconds: a row a contender, a column a case."""
    head = ["ms a ping, median", *(case.size for case in cases)]
    rows = [
        [
            contender.label,
            *(
                figure(case.runs[contender.name].median_ms)
                if contender.name in case.runs
                else ABSENT
                for case in cases
            ),
        ]
        for contender in CONTENDERS
        if any(contender.name in case.runs for case in cases)
    ]
    return table(head, rows)


def case_table(case: CaseResult, bytes_a_second: float, pings: int) -> str:
    """All that was measured of each contender on one case."""
    head = ["map and input", "ms median", "ms p95", "voxels a ping", "Mvoxel/s"]
    head += ["bytes a voxel", "peak RSS MB", "times the bound"]
    rows = [
        _run(contender, case.runs[contender.name], bytes_a_second, pings)
        for contender in CONTENDERS
        if contender.name in case.runs
    ]
    return table(head, rows)


def _run(contender: Contender, run: Measured, bytes_a_second: float, pings: int) -> Row:
    done = len(run.ms)
    fewer = "" if done == pings else f" ({done} ping{'s' if done > 1 else ''})"
    rss_mb, start_mb = run.peak_rss_bytes / 1e6, run.start_rss_bytes / 1e6
    return (
        contender.label,
        f"{figure(run.median_ms)}{fewer}",
        figure(run.p95_ms),
        f"{run.touched_a_ping / 1e3:,.0f} k",
        figure(run.touched_a_second / 1e6),
        f"{run.bytes_a_voxel:.1f}",
        f"{rss_mb:.0f} ({rss_mb - start_mb:.0f})",
        figure(run.median_ms / run.bound_ms(bytes_a_second)),
    )


def per_voxel(cases: Sequence[CaseResult]) -> str:
    """What each does of the same first returns, and what a voxel of that costs."""
    head = ["case", "OctoMap", "OpenVDB", "ours, rays", "ours, exact", "ours, default bound"]
    head += ["OctoMap : exact, default", "OpenVDB : exact, default"]
    return table(head, [_voxels(case) for case in cases])


def _voxels(case: CaseResult) -> Row:
    octomap = case.runs.get(OCTOMAP.name)
    vdbs = [case.runs[way.name] for way in OPENVDB if way.name in case.runs]
    vdb = min(vdbs, key=lambda run: run.median_ms, default=None)
    rays, exact, default = (
        case.runs.get(name) for name in (RAYS_FIRST, EXACT_FIRST, DEFAULT_FIRST)
    )
    amounts = [
        f"{run.touched_a_ping / 1e3:,.0f} k, {figure(run.ns_a_voxel)} ns" if run else ABSENT
        for run in (octomap, vdb, rays, exact, default)
    ]
    ratios = [
        ", ".join(
            f"{figure(rival.ns_a_voxel / ours.ns_a_voxel)}x" if rival and ours else ABSENT
            for ours in (exact, default)
        )
        for rival in (octomap, vdb)
    ]
    return (case.name, *amounts, *ratios)


def accuracy(results: Results) -> str:
    """A row a case and input, with columns for `rays` and for the default."""
    head = ["case, input"]
    for way in ("rays", "default"):
        head += [f"{way}: other class (known to one only)", "mean, 95th percentile", "where shared"]
    rows = [
        (f"{case.name}, {takes}", *_differences(ways))
        for case in results.cases
        for takes, ways in case.accuracy.items()
    ]
    return table([*head, "pings"], rows)


def _differences(ways: dict[str, Accuracy]) -> Iterator[str]:
    for way in ("rays", "default"):
        found = ways[way]
        yield f"{found.class_share:.3%} ({found.one_only_share:.3%})"
        yield f"{found.mean:.2g}, {found.p95:.2g}"
        yield f"{found.mean_of_shared:.2g}"
    yield f"{ways['rays'].pings}"


def open_water(results: Results) -> str:
    """A row an integrator, a column a range."""
    ranges = list(next(iter(results.open_water.values())))
    head = ("integrator", *(f"{range_m} m" for range_m in ranges))
    rows = [
        (way, *(f"{figure(ms)} ms" for ms in times_ms.values()))
        for way, times_ms in results.open_water.items()
    ]
    return table(head, rows)
